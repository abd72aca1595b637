//! Columns of tables from other libraries.

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type};
use arrow_array::{Array, ArrayRef, OffsetSizeTrait, RecordBatch};
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
        DataType::Float32 => Ok(column.as_primitive::<Float32Type>().values().to_vec()),
        DataType::Float64 => {
            let values = column.as_primitive::<Float64Type>().values();
            Ok(values.iter().map(|&value| value as f32).collect())
        }
        other => Err(Wrong::Column(format!(
            "`{name}` has type {other}, expected floating point numbers"
        ))),
    }
}

/// A column of lists of numbers.
pub(crate) fn lists(
    batch: &RecordBatch,
    name: &str,
    expected: &str,
) -> Result<Vec<Vec<f32>>, Wrong> {
    let column = column(batch, name, expected)?;
    match column.data_type() {
        DataType::List(_) => lists_of::<i32>(column, name),
        DataType::LargeList(_) => lists_of::<i64>(column, name),
        other => {
            Err(Wrong::Column(format!("`{name}` has type {other}, expected lists of numbers")))
        }
    }
}

fn lists_of<Offset: OffsetSizeTrait>(
    column: &ArrayRef,
    name: &str,
) -> Result<Vec<Vec<f32>>, Wrong> {
    let lists = column.as_list::<Offset>();
    let of_row = |row: usize| {
        if lists.is_null(row) {
            return Err(Wrong::Row { row, found: format!("a null in `{name}`, expected a list") });
        }
        numbers(&lists.value(row), name).map_err(|wrong| match wrong {
            Wrong::Row { row: at, found } => {
                Wrong::Row { row, found: format!("{found} (number {at} of its list)") }
            }
            of_column => of_column,
        })
    };
    (0..lists.len()).map(of_row).collect()
}
