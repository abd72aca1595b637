//! Tables of numbers, separated by commas, the first a time.

use std::path::Path;

use crate::error::ImportError;
use crate::input::{Line, Lines, Meter, excerpt};
use crate::record::{Losses, representable};

/// A table of `N` columns beside the time.
pub(super) struct Table<const N: usize> {
    lines: Lines,
    name: String,
    /// What a row consists of, for errors.
    columns: &'static str,
    /// Whether a row was understood; before, a line that is not is no damage but another format.
    sound: bool,
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
        Ok(Self { lines, name: crate::file_name(path), columns, sound: false })
    }

    /// The next row that is understood; its values may be no numbers (NaN). Comments (`#`), empty
    /// lines and one line of column names are passed over, all else is counted.
    pub fn next(&mut self, losses: &mut Losses) -> Result<Option<Row<N>>, ImportError> {
        while let Some(line) = self.lines.next()? {
            let text = line.text.trim();
            if text.is_empty() || text.starts_with('#') {
                continue;
            }
            match row(text) {
                Some(row) if !representable(row.stamp_ns) => {
                    let reason = format!("rows of {} before 1970 or after 2037", self.name);
                    losses.dropped.add(reason, 1);
                }
                Some(row) => {
                    self.sound = true;
                    if !line.whole {
                        let reason = format!("last rows of {} without a line's end", self.name);
                        losses.remarks.add(reason, 1);
                    }
                    return Ok(Some(row));
                }
                None if line.number == 1 && text.starts_with(char::is_alphabetic) => {}
                None if !self.sound => return Err(self.foreign(&line)),
                None => {
                    let reason = format!("rows of {} that are not {}", self.name, self.columns);
                    losses.dropped.add(reason, 1);
                }
            }
        }
        Ok(None)
    }

    /// Counts a row that has a value which is no number.
    pub fn not_a_number(&self, losses: &mut Losses) {
        let reason = format!("rows of {} with a value that is no number (NaN)", self.name);
        losses.dropped.add(reason, 1);
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    fn foreign(&self, line: &Line) -> ImportError {
        let place = format!("line {}", line.number);
        ImportError::foreign(self.lines.path(), place, excerpt(&line.text), self.columns)
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

/// Microseconds since the epoch, as a whole number or in floating point, which holds them exactly
/// up to 2^53 (the year 2255).
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
    fn microseconds_are_whole_numbers_or_floats_that_hold_them() {
        assert_eq!(utime_ns("1326030975726043"), Some(1_326_030_975_726_043_000));
        assert_eq!(utime_ns("1.326030975726043e+15"), Some(1_326_030_975_726_043_000));
        assert_eq!(utime_ns("1326030975726043.5"), None);
        assert_eq!(utime_ns("nan"), None);
        assert_eq!(utime_ns("9223372036854775807"), None);
    }

    #[test]
    fn a_row_has_all_its_columns() {
        assert_eq!(row::<1>("1,2.5"), Some(Row { stamp_ns: 1000, values: [2.5] }));
        assert_eq!(row::<2>("1,2.5"), None);
        assert!(row::<1>("1, NaN ").unwrap().values[0].is_nan());
    }
}
