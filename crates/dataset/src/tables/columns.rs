//! Typed access to the columns of a record batch, with errors that name file and column.

use std::path::Path;

use arrow_array::cast::AsArray;
use arrow_array::types::ArrowPrimitiveType;
use arrow_array::{Array, BooleanArray, PrimitiveArray, RecordBatch, StringArray};

use super::{Result, TableError};

pub(super) struct Columns<'a> {
    path: &'a Path,
    batch: &'a RecordBatch,
}

impl<'a> Columns<'a> {
    pub(super) fn new(path: &'a Path, batch: &'a RecordBatch) -> Self {
        Self { path, batch }
    }

    pub(super) fn numbers<T: ArrowPrimitiveType>(
        &self,
        name: &str,
    ) -> Result<&'a PrimitiveArray<T>> {
        let array = self.nullable_numbers(name)?;
        self.check_no_nulls(name, array)?;
        Ok(array)
    }

    pub(super) fn nullable_numbers<T: ArrowPrimitiveType>(
        &self,
        name: &str,
    ) -> Result<&'a PrimitiveArray<T>> {
        let column = self.column(name)?;
        column.as_primitive_opt::<T>().ok_or_else(|| {
            self.error(
                name,
                "a number column of the documented type",
                column.data_type().to_string(),
            )
        })
    }

    pub(super) fn booleans(&self, name: &str) -> Result<&'a BooleanArray> {
        let column = self.column(name)?;
        let array = column
            .as_boolean_opt()
            .ok_or_else(|| self.error(name, "a boolean column", column.data_type().to_string()))?;
        self.check_no_nulls(name, array)?;
        Ok(array)
    }

    pub(super) fn strings(&self, name: &str) -> Result<&'a StringArray> {
        let array = self.nullable_strings(name)?;
        self.check_no_nulls(name, array)?;
        Ok(array)
    }

    pub(super) fn nullable_strings(&self, name: &str) -> Result<&'a StringArray> {
        let column = self.column(name)?;
        column
            .as_string_opt::<i32>()
            .ok_or_else(|| self.error(name, "a string column", column.data_type().to_string()))
    }

    pub(super) fn error(&self, column: &str, expected: &'static str, found: String) -> TableError {
        TableError::Column {
            path: self.path.to_owned(),
            column: column.to_owned(),
            expected,
            found,
        }
    }

    pub(super) fn column(&self, name: &str) -> Result<&'a dyn Array> {
        self.batch
            .column_by_name(name)
            .map(AsRef::as_ref)
            .ok_or_else(|| self.error(name, "a column of this name", "none".to_owned()))
    }

    fn check_no_nulls(&self, name: &str, array: &dyn Array) -> Result<()> {
        match array.null_count() {
            0 => Ok(()),
            n => Err(self.error(name, "no nulls", format!("{n} nulls"))),
        }
    }
}
