//! The compiled part of the Python package: features, models, tables, and the program.
//!
//! `loopboost/__init__.py` has the interface for users. It checks and converts arrays. What is here takes contiguous
//! arrays of one type.

mod columns;
mod features;
mod model;
mod poses;
mod scans;
mod table;

use std::ffi::OsString;

use pyo3::prelude::*;

#[pymodule]
fn _loopboost(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<model::Model>()?;
    module.add_class::<scans::Rows>()?;
    module.add_class::<table::Table>()?;
    module.add_function(wrap_pyfunction!(features::feature_names, module)?)?;
    module.add_function(wrap_pyfunction!(features::featurize, module)?)?;
    module.add_function(wrap_pyfunction!(features::featurize_table, module)?)?;
    module.add_function(wrap_pyfunction!(scans::read_scans, module)?)?;
    module.add_function(wrap_pyfunction!(scans::read_poses, module)?)?;
    module.add_function(wrap_pyfunction!(poses::to_tum, module)?)?;
    module.add_function(wrap_pyfunction!(main, module)?)
}

/// Does what the command line asks for, and returns the exit code. `args` starts with the name of the program.
#[pyfunction]
fn main(py: Python<'_>, args: Vec<OsString>) -> u8 {
    py.detach(|| loopboost::main_from(args))
}

/// The classes of `loopboost/_errors.py`.
#[derive(Clone, Copy)]
enum Class {
    Argument,
    Input,
}

/// An error of one of these classes.
fn error(py: Python<'_>, class: Class, message: impl std::fmt::Display) -> PyErr {
    let name = match class {
        Class::Argument => "ArgumentError",
        Class::Input => "InputError",
    };
    let made = py
        .import("loopboost._errors")
        .and_then(|errors| errors.getattr(name)?.call1((message.to_string(),)));
    made.map_or_else(|failed| failed, PyErr::from_value)
}
