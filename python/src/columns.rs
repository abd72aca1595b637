//! Columns of tables from other libraries.

use arrow_array::cast::AsArray;
use arrow_array::types::{ArrowPrimitiveType, Float32Type, Float64Type, Int32Type, Int64Type};
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_schema::DataType;

use crate::table::column_names;

/// What is wrong with a table.
pub(crate) enum Wrong {
    Column(String),
    Row { row: usize, found: String },
}

impl Wrong {
    /// As text, in a batch after this many rows.
    pub(crate) fn after(self, n_rows: usize) -> String {
        match self {
            Self::Column(found) => found,
            Self::Row { row, found } => format!("row {}: {found}", n_rows + row),
        }
    }
}

/// A column. `expected` says what the table should have.
pub(crate) fn column<'a>(
    batch: &'a RecordBatch,
    name: &str,
    expected: &str,
) -> Result<&'a ArrayRef, Wrong> {
    batch.column_by_name(name).ok_or_else(|| {
        let have = column_names(batch.schema_ref()).join(", ");
        Wrong::Column(format!("no column `{name}`; {expected}, this one has: {have}"))
    })
}

/// A column of numbers without nulls, rounded to 32 bits as in the tables of the program.
pub(crate) fn numbers(column: &ArrayRef, name: &str) -> Result<Vec<f32>, Wrong> {
    if let Some(row) = (0..column.len()).find(|&row| column.is_null(row)) {
        return Err(Wrong::Row { row, found: format!("a null in `{name}`, expected a number") });
    }
    match column.data_type() {
        DataType::Float32 => Ok(rounded::<Float32Type>(column, |value| value)),
        DataType::Float64 => Ok(rounded::<Float64Type>(column, |value| value as f32)),
        DataType::Int32 => Ok(rounded::<Int32Type>(column, |value| value as f32)),
        DataType::Int64 => Ok(rounded::<Int64Type>(column, |value| value as f32)),
        other => Err(Wrong::Column(format!(
            "the numbers in `{name}` have type {other}, expected floating point or whole numbers of 32 or 64 bits; cast them"
        ))),
    }
}

fn rounded<T: ArrowPrimitiveType>(column: &ArrayRef, round: fn(T::Native) -> f32) -> Vec<f32> {
    column.as_primitive::<T>().values().iter().copied().map(round).collect()
}

/// A column of lists of numbers.
pub(crate) fn lists(
    batch: &RecordBatch,
    name: &str,
    expected: &str,
) -> Result<Vec<Vec<f32>>, Wrong> {
    let column = column(batch, name, expected)?;
    let list_of_row: Box<dyn Fn(usize) -> ArrayRef> = match column.data_type() {
        DataType::List(_) => Box::new(|row| column.as_list::<i32>().value(row)),
        DataType::LargeList(_) => Box::new(|row| column.as_list::<i64>().value(row)),
        DataType::FixedSizeList(..) => Box::new(|row| column.as_fixed_size_list().value(row)),
        other => {
            return Err(Wrong::Column(format!(
                "`{name}` has type {other}, expected lists of numbers"
            )));
        }
    };
    let of_row = |row: usize| {
        if column.is_null(row) {
            return Err(Wrong::Row { row, found: format!("a null in `{name}`, expected a list") });
        }
        numbers(&list_of_row(row), name).map_err(|wrong| match wrong {
            Wrong::Row { row: at, found } => {
                Wrong::Row { row, found: format!("{found} (number {at} of its list)") }
            }
            of_column => of_column,
        })
    };
    (0..column.len()).map(of_row).collect()
}
