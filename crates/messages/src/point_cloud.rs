//! A point cloud with interleaved fields, as sensors and drivers send it.

use std::borrow::Cow;

use crate::{MessageError, Result};

/// A point cloud in the frame of the sensor: `height` rows of `width` points.
///
/// A cloud from a reader is consistent: every field fits into a point, and all rows are complete.
#[derive(Debug, Clone, PartialEq)]
pub struct PointCloud<'a> {
    /// Header stamp \[ns since the epoch\]. It depends on the driver which point the stamp belongs to.
    pub stamp_ns: i64,
    /// Number of points in a row.
    pub width: usize,
    /// Number of rows; 1 for an unordered cloud.
    pub height: usize,
    /// Distance from one point to the next \[bytes\].
    pub point_step: usize,
    /// Distance from one row to the next \[bytes\].
    pub row_step: usize,
    /// Whether the fields are big endian.
    pub big_endian: bool,
    /// The fields of a point.
    pub fields: Vec<PointField>,
    /// The points.
    pub data: Cow<'a, [u8]>,
}

/// A field of a point.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PointField {
    /// The name, for example `x` or `ring`.
    pub name: String,
    /// Offset from the start of the point \[bytes\].
    pub offset: usize,
    /// The data type.
    pub kind: Scalar,
}

/// The data type of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Scalar {
    /// `i8`
    I8,
    /// `u8`
    U8,
    /// `i16`
    I16,
    /// `u16`
    U16,
    /// `i32`
    I32,
    /// `u32`
    U32,
    /// `f32`
    F32,
    /// `f64`
    F64,
}

impl Scalar {
    /// The size \[bytes\].
    pub fn n_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

impl<'a> PointCloud<'a> {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.width.saturating_mul(self.height)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The values of a field for all points. `None` if the cloud has no field with this name, or if it
    /// is inconsistent, which can only happen for a cloud that does not come from a reader.
    pub fn column(&self, name: &str) -> Option<Column<'_>> {
        let field = self.fields.iter().find(|field| field.name == name)?;
        self.check_field(field).ok()?;
        self.check_extent().ok()?;
        Some(Column {
            data: &self.data,
            kind: field.kind,
            big_endian: self.big_endian,
            offset: field.offset,
            point_step: self.point_step,
            width: self.width,
            row_step: self.row_step,
            has_gaps: 1 < self.height && self.row_step != self.width * self.point_step,
            len: self.len(),
        })
    }

    /// Checks that the sizes and the fields are consistent. A single row does not need `row_step`, so
    /// the value from the message is replaced by the length of the row. In a cloud without points it
    /// is replaced by 0, and the other sizes may have any value.
    pub(crate) fn checked(mut self) -> Result<Self> {
        if self.is_empty() {
            self.row_step = 0;
        } else if self.height == 1 {
            self.row_step = self.width.saturating_mul(self.point_step);
        }
        for field in &self.fields {
            self.check_field(field)?;
        }
        self.check_extent()?;
        Ok(self)
    }

    fn check_field(&self, field: &PointField) -> Result<()> {
        let end = field.offset.saturating_add(field.kind.n_bytes());
        if self.point_step < end {
            return Err(layout(format!(
                "field `{}` ends at byte {end}, but a point has {} bytes",
                field.name, self.point_step
            )));
        }
        Ok(())
    }

    /// Checks that all rows are complete and do not overlap. There are then no more points than bytes.
    fn check_extent(&self) -> Result<()> {
        let Self { width, height, point_step, row_step, .. } = *self;
        if width == 0 || height == 0 {
            return Ok(());
        }
        let row = width.checked_mul(point_step);
        if let Some(row) = row
            && 1 < height
            && row_step < row
        {
            return Err(layout(format!(
                "rows are {row_step} bytes apart, but {width} points of {point_step} bytes have {row} bytes"
            )));
        }
        let needed = (height - 1)
            .checked_mul(row_step)
            .zip(row)
            .and_then(|(before, row)| before.checked_add(row));
        match needed {
            Some(needed) if point_step != 0 && needed <= self.data.len() => Ok(()),
            _ => Err(layout(format!(
                "{width} x {height} points of {point_step} bytes do not fit into {} bytes",
                self.data.len()
            ))),
        }
    }

    /// Whether no floating-point field is NaN or infinite.
    pub(crate) fn is_dense(&self) -> bool {
        self.fields
            .iter()
            .filter_map(|field| self.column(&field.name))
            .all(|column| (0..column.len()).all(|index| column.get(index).is_finite()))
    }
}

fn layout(detail: String) -> MessageError {
    MessageError::CloudLayout { detail }
}

/// One field of every point.
#[derive(Debug, Clone, Copy)]
pub struct Column<'a> {
    data: &'a [u8],
    kind: Scalar,
    big_endian: bool,
    offset: usize,
    point_step: usize,
    width: usize,
    row_step: usize,
    has_gaps: bool,
    len: usize,
}

impl Column<'_> {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The value of the point `index = row * width + column`. An `f64` represents every data type
    /// exactly.
    ///
    /// # Panics
    /// Panics if there is no such point.
    #[inline]
    pub fn get(&self, index: usize) -> f64 {
        let start = if self.has_gaps {
            index / self.width * self.row_step + index % self.width * self.point_step
        } else {
            index * self.point_step
        };
        let at = start + self.offset;
        match self.kind {
            Scalar::I8 => f64::from(self.data[at] as i8),
            Scalar::U8 => f64::from(self.data[at]),
            Scalar::I16 => f64::from(u16::from_le_bytes(self.raw(at)) as i16),
            Scalar::U16 => f64::from(u16::from_le_bytes(self.raw(at))),
            Scalar::I32 => f64::from(u32::from_le_bytes(self.raw(at)) as i32),
            Scalar::U32 => f64::from(u32::from_le_bytes(self.raw(at))),
            Scalar::F32 => f64::from(f32::from_le_bytes(self.raw(at))),
            Scalar::F64 => f64::from_le_bytes(self.raw(at)),
        }
    }

    /// `N` bytes in little-endian order.
    #[inline]
    fn raw<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut raw = [0; N];
        raw.copy_from_slice(&self.data[at..at + N]);
        if self.big_endian {
            raw.reverse();
        }
        raw
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(name: &str, offset: usize, kind: Scalar) -> PointField {
        PointField { name: name.to_owned(), offset, kind }
    }

    /// Two rows of two points. A point has 3 bytes, an `i8` and a `u16`. Rows are 8 bytes apart.
    fn padded(big_endian: bool) -> PointCloud<'static> {
        PointCloud {
            stamp_ns: 0,
            width: 2,
            height: 2,
            point_step: 3,
            row_step: 8,
            big_endian,
            fields: vec![field("a", 0, Scalar::I8), field("b", 1, Scalar::U16)],
            data: vec![255, 1, 2, 1, 3, 4, 9, 9, 2, 5, 6, 3, 7, 8].into(),
        }
    }

    #[test]
    fn a_column_skips_the_padding_of_rows_in_both_byte_orders() {
        let values = |cloud: &PointCloud<'_>, name| {
            let column = cloud.column(name).unwrap();
            (0..column.len()).map(|index| column.get(index)).collect::<Vec<_>>()
        };
        let cloud = padded(false).checked().unwrap();
        assert_eq!(values(&cloud, "a"), [-1.0, 1.0, 2.0, 3.0]);
        assert_eq!(values(&cloud, "b"), [513.0, 1027.0, 1541.0, 2055.0]);
        assert_eq!(values(&padded(true), "b"), [258.0, 772.0, 1286.0, 1800.0]);
        assert!(cloud.column("c").is_none());
    }

    #[test]
    fn every_data_type_is_read_in_both_byte_orders() {
        let minus_two = [
            (Scalar::I8, (-2i8).to_le_bytes().to_vec(), -2.0),
            (Scalar::U8, vec![254], 254.0),
            (Scalar::I16, (-2i16).to_le_bytes().to_vec(), -2.0),
            (Scalar::U16, vec![254, 255], 65_534.0),
            (Scalar::I32, (-2i32).to_le_bytes().to_vec(), -2.0),
            (Scalar::U32, vec![254, 255, 255, 255], 4_294_967_294.0),
            (Scalar::F32, (-2f32).to_le_bytes().to_vec(), -2.0),
            (Scalar::F64, (-2f64).to_le_bytes().to_vec(), -2.0),
        ];
        for (kind, mut data, expected) in minus_two {
            assert_eq!(data.len(), kind.n_bytes());
            for big_endian in [false, true] {
                let cloud = PointCloud {
                    width: 1,
                    height: 1,
                    point_step: kind.n_bytes(),
                    big_endian,
                    fields: vec![field("v", 0, kind)],
                    data: data.clone().into(),
                    ..padded(false)
                };
                assert_eq!(cloud.column("v").unwrap().get(0), expected, "{kind:?}");
                data.reverse();
            }
        }
    }

    #[test]
    fn an_inconsistent_layout_is_an_error() {
        let error = |change: fn(&mut PointCloud<'_>)| {
            let mut cloud = padded(false);
            change(&mut cloud);
            assert!(cloud.column("b").is_none());
            cloud.checked().unwrap_err().to_string()
        };
        assert_eq!(
            error(|cloud| cloud.fields[1].offset = 2),
            "invalid point cloud layout: field `b` ends at byte 4, but a point has 3 bytes"
        );
        assert_eq!(
            error(|cloud| cloud.row_step = 5),
            "invalid point cloud layout: rows are 5 bytes apart, but 2 points of 3 bytes have 6 bytes"
        );
        assert_eq!(
            error(|cloud| cloud.height = 3),
            "invalid point cloud layout: 2 x 3 points of 3 bytes do not fit into 14 bytes"
        );
        error(|cloud| cloud.fields[1].offset = usize::MAX);
        error(|cloud| cloud.width = usize::MAX);
        error(|cloud| (cloud.height, cloud.row_step) = (usize::MAX, usize::MAX));
        let points_without_bytes =
            PointCloud { point_step: 0, row_step: 0, fields: vec![], ..padded(false) };
        assert!(points_without_bytes.checked().is_err());
    }

    #[test]
    fn the_row_step_of_a_single_row_is_ignored() {
        for row_step in [0, 6, 7, usize::MAX] {
            let cloud = PointCloud { height: 1, row_step, ..padded(false) }.checked().unwrap();
            assert_eq!((cloud.row_step, cloud.column("b").unwrap().get(1)), (6, 1027.0));
        }
    }
}
