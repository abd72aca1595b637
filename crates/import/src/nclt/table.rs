//! Reads tables of numbers separated by commas. The first column is a time.

use std::path::Path;

use dataset::{Loss, LossKind, Losses, Subject};

use crate::error::ImportError;
use crate::input::{Line, Lines, Meter, excerpt, file_name};
use crate::record::is_representable;

/// A table of a time and `N` more columns.
pub(super) struct Table<const N: usize> {
    lines: Lines,
    /// The columns, for messages.
    columns: &'static str,
    /// Whether any row was parsed. Before the first one, a line that does not parse is an error,
    /// because the file probably has another format. After it, such a line is a loss.
    has_row: bool,
}

/// One row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Row<const N: usize> {
    /// \[ns since the epoch\]
    pub stamp_ns: i64,
    pub values: [f64; N],
}

impl<const N: usize> Table<N> {
    pub fn open(path: &Path, columns: &'static str, meter: &Meter) -> Result<Self, ImportError> {
        let lines = Lines::open(path, meter)?;
        Ok(Self { lines, columns, has_row: false })
    }

    /// The next row. Its values can be NaN. Comments (`#`), empty lines and one line with column
    /// names are skipped. All other lines are counted as losses.
    pub fn next(&mut self, losses: &mut Losses) -> Result<Option<Row<N>>, ImportError> {
        while let Some(line) = self.lines.next()? {
            let text = line.text.trim();
            if text.is_empty() || text.starts_with('#') {
                continue;
            }
            match row(text) {
                Some(row) if !is_representable(row.stamp_ns) => {
                    let kind = LossKind::TimesOutOfRange { item: "row".to_owned() };
                    losses.add(self.loss(kind), 1);
                }
                Some(row) => {
                    self.has_row = true;
                    if !line.is_complete {
                        losses.add(self.loss(LossKind::RowWithoutLineEnd), 1);
                    }
                    return Ok(Some(row));
                }
                None if line.number == 1 && text.starts_with(char::is_alphabetic) => {}
                None if !self.has_row => return Err(self.unexpected(&line)),
                None => {
                    let kind = LossKind::MalformedRows { columns: self.columns.to_owned() };
                    losses.add(self.loss(kind), 1);
                }
            }
        }
        Ok(None)
    }

    /// A loss of this file.
    pub fn loss(&self, kind: LossKind) -> Loss {
        Loss::new(kind, Subject::file(file_name(self.lines.path())))
    }

    fn unexpected(&self, line: &Line) -> ImportError {
        let place = format!("line {}", line.number);
        ImportError::unexpected(self.lines.path(), place, excerpt(&line.text), self.columns)
    }
}

fn row<const N: usize>(text: &str) -> Option<Row<N>> {
    let mut fields = text.split(',').map(str::trim);
    let stamp_ns = utime_ns(fields.next()?)?;
    let mut values = [0.0; N];
    for value in &mut values {
        *value = fields.next()?.parse().ok()?;
    }
    Some(Row { stamp_ns, values })
}

/// Parses microseconds since the epoch. The text is an integer, or a floating-point number without
/// a fraction. Floating-point numbers are exact up to 2^53 (the year 2255).
fn utime_ns(text: &str) -> Option<i64> {
    const EXACT: f64 = (1_u64 << 53) as f64;
    let us = match text.parse() {
        Ok(us) => us,
        Err(_) => {
            let us: f64 = text.parse().ok()?;
            (us.fract() == 0.0 && us.abs() < EXACT).then_some(us as i64)?
        }
    };
    us.checked_mul(1000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_integers_or_floats_without_a_fraction() {
        assert_eq!(utime_ns("1326030975726043"), Some(1_326_030_975_726_043_000));
        assert_eq!(utime_ns("1.326030975726043e+15"), Some(1_326_030_975_726_043_000));
        assert_eq!(utime_ns("1326030975726043.5"), None);
        assert_eq!(utime_ns("nan"), None);
        assert_eq!(utime_ns("9223372036854775807"), None);
    }

    #[test]
    fn a_row_with_a_missing_column_does_not_parse() {
        assert_eq!(row::<1>("1,2.5"), Some(Row { stamp_ns: 1000, values: [2.5] }));
        assert_eq!(row::<2>("1,2.5"), None);
        assert!(row::<1>("1, NaN ").unwrap().values[0].is_nan());
    }
}
