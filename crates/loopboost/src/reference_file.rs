//! Files with surveyed positions and poses.

use std::path::Path;

use anyhow::{Result, anyhow};
use dataset::Pose2;

/// A row of the file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Surveyed {
    /// The log; `None` if the file has no column `log`.
    pub(crate) log: Option<String>,
    pub(crate) stamp_ns: i64,
    /// The heading is 0 if it is not known.
    pub(crate) pose: Pose2,
    pub(crate) has_heading: bool,
    /// Standard deviation in each direction \[m\].
    pub(crate) std_m: Option<f64>,
    /// Standard deviation of the heading \[rad\].
    pub(crate) std_rad: Option<f64>,
}

const COLUMNS: [&str; 8] =
    ["log", "stamp_ns", "time_s", "x_m", "y_m", "heading_rad", "std_m", "std_rad"];

/// Reads a file. Lines that start with `#` and empty lines are left out.
pub(crate) fn read(path: &Path) -> Result<Vec<Surveyed>> {
    let text = std::fs::read_to_string(path).map_err(|error| {
        anyhow!("`optimize.references`: cannot read {}: {error}", path.display())
    })?;
    parse(&text).map_err(|fault| anyhow!("{}{fault}", path.display()))
}

/// The error starts with the number of the line.
fn parse(text: &str) -> Result<Vec<Surveyed>, String> {
    // Spreadsheets write a byte order mark.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| {
        let line = line.trim();
        !line.is_empty() && !line.starts_with('#')
    });
    let (number, header) = lines.next().ok_or_else(|| {
        format!(" is empty; expected a header with columns of `{}`", COLUMNS.join("`, `"))
    })?;
    let header = cells_of(number, header)?;
    let names = names_of(number, &header)?;
    let column = |name: &str| names.iter().position(|other| *other == name);
    let row = |(number, line): (usize, &str)| {
        let cells = cells_of(number, line)?;
        if cells.len() != names.len() {
            let (found, expected) = (cells.len(), names.len());
            return Err(format!(":{number}: {found} cells, expected {expected} as in the header"));
        }
        // An empty cell is unknown.
        let cell = |name: &str| column(name).map(|k| &cells[k]).filter(|cell| !cell.is_empty());
        let value = |name: &str| -> Result<Option<f64>, String> {
            let Some(cell) = cell(name) else { return Ok(None) };
            let value = cell.parse::<f64>().ok().filter(|value| value.is_finite());
            let fault = || format!(":{number}: `{name}` is `{cell}`, expected a number");
            value.ok_or_else(fault).map(Some)
        };
        let needed = |name: &str| -> Result<f64, String> {
            value(name)?.ok_or_else(|| format!(":{number}: `{name}` is empty, expected a number"))
        };
        let std = |name: &str| -> Result<Option<f64>, String> {
            match value(name)? {
                Some(std) if std <= 0.0 => {
                    Err(format!(":{number}: `{name}` is {std}, expected more than 0"))
                }
                std => Ok(std),
            }
        };
        let stamp_ns = match cell("stamp_ns") {
            Some(cell) => cell.parse::<i64>().map_err(|_| {
                format!(":{number}: `stamp_ns` is `{cell}`, expected a whole number of nanoseconds")
            })?,
            None if column("time_s").is_none() => {
                return Err(format!(":{number}: `stamp_ns` is empty, expected a whole number"));
            }
            None => (needed("time_s")? * 1e9).round() as i64,
        };
        let heading_rad = value("heading_rad")?;
        let (x_m, y_m) = (needed("x_m")?, needed("y_m")?);
        Ok(Surveyed {
            log: cell("log").map(str::to_owned),
            stamp_ns,
            pose: Pose2 { x_m, y_m, heading_rad: heading_rad.unwrap_or(0.0) },
            has_heading: heading_rad.is_some(),
            std_m: std("std_m")?,
            std_rad: std("std_rad")?,
        })
    };
    lines.map(row).collect()
}

/// The names of the columns, in the order of the file.
fn names_of(number: usize, header: &csv::StringRecord) -> Result<Vec<&str>, String> {
    let mut names: Vec<&str> = Vec::new();
    for name in header {
        if !COLUMNS.contains(&name) {
            let columns = COLUMNS.join("`, `");
            return Err(format!(
                ":{number}: unknown column `{name}`, expected columns of `{columns}`"
            ));
        }
        if names.contains(&name) {
            return Err(format!(":{number}: two columns `{name}`; remove one"));
        }
        names.push(name);
    }
    for either in [&["x_m"][..], &["y_m"], &["stamp_ns", "time_s"]] {
        if !either.iter().any(|name| names.contains(name)) {
            return Err(format!(":{number}: no column `{}`; add it", either.join("` or `")));
        }
    }
    Ok(names)
}

/// The cells of a line, without quotes and the spaces around them.
fn cells_of(number: usize, line: &str) -> Result<csv::StringRecord, String> {
    let mut options = csv::ReaderBuilder::new();
    let mut reader = options.has_headers(false).trim(csv::Trim::All).from_reader(line.as_bytes());
    let cells = reader.records().next().transpose();
    Ok(cells.map_err(|error| format!(":{number}: {error}"))?.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_can_be_in_any_order_and_cells_empty() {
        let text = "# surveyed\ny_m, x_m,log,stamp_ns,heading_rad\n2,-1.5,a,7,\n\n3,4,a,8,0.5\n";
        let rows = parse(text).unwrap();
        assert_eq!(rows.len(), 2);
        assert_eq!((rows[0].pose.x_m, rows[0].pose.y_m, rows[0].stamp_ns), (-1.5, 2.0, 7));
        assert!(!rows[0].has_heading && rows[1].has_heading);
        assert_eq!((rows[1].pose.heading_rad, rows[1].log.as_deref()), (0.5, Some("a")));
        assert_eq!((rows[1].std_m, rows[1].std_rad), (None, None));
        let rows = parse("\u{feff}log,stamp_ns,x_m,y_m\r\n\"day, 1\",7,0,0\r\n").unwrap();
        assert_eq!((rows[0].log.as_deref(), rows[0].stamp_ns), (Some("day, 1"), 7));
        let rows = parse("time_s,x_m,y_m,std_m\n1.5,0,0,0.1").unwrap();
        assert_eq!((rows[0].stamp_ns, rows[0].std_m), (1_500_000_000, Some(0.1)));
    }

    #[test]
    fn faults_name_their_line() {
        for (text, expected) in [
            ("", " is empty"),
            ("x_m,y_m\n", ":1: no column `stamp_ns`"),
            ("stamp_ns,x_m,y_m,colour\n", ":1: unknown column `colour`"),
            ("stamp_ns,x_m,y_m,x_m\n", ":1: two columns `x_m`"),
            ("stamp_ns,x_m,y_m\n,2,3\n", ":2: `stamp_ns` is empty"),
            ("stamp_ns,x_m,y_m\n1,2\n", ":2: 2 cells, expected 3"),
            ("stamp_ns,x_m,y_m\n\n1.5,2,3\n", ":3: `stamp_ns` is `1.5`"),
            ("stamp_ns,x_m,y_m\n1,nan,3\n", ":2: `x_m` is `nan`"),
            ("stamp_ns,x_m,y_m\n1,,3\n", ":2: `x_m` is empty"),
            ("stamp_ns,x_m,y_m,std_m\n1,2,3,0\n", ":2: `std_m` is 0, expected more than 0"),
        ] {
            let fault = parse(text).unwrap_err();
            assert!(fault.starts_with(expected), "{fault}");
        }
    }
}
