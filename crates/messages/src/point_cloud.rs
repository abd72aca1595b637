//! A cloud of points whose fields lie interleaved in memory, as sensors and drivers send it.

use std::borrow::Cow;

use crate::{MessageError, Result};

/// A cloud of points in the sensor's frame: `height` rows of `width` points.
///
/// A cloud that was read is consistent: every field fits into a point, and all rows are there.
#[derive(Debug, Clone, PartialEq)]
pub struct PointCloud<'a> {
    /// Header stamp; which point it belongs to is the driver's choice \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Points in a row.
    pub width: usize,
    /// Rows; 1 in a cloud without order.
    pub height: usize,
    /// From a point to the next \[bytes\].
    pub point_step: usize,
    /// From a row to the next \[bytes\].
    pub row_step: usize,
    /// Byte order of the fields.
    pub big_endian: bool,
    /// What a point consists of.
    pub fields: Vec<PointField>,
    /// The points.
    pub data: Cow<'a, [u8]>,
}

/// One value of each point.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PointField {
    /// Its name, as `x` or `ring`.
    pub name: String,
    /// From the point's start \[bytes\].
    pub offset: usize,
    /// How it is stored.
    pub kind: Scalar,
}

/// How a field is stored.
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
    /// Its size \[bytes\].
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

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The field of that name, of every point; none where the cloud has no such field (or was built
    /// by hand and contradicts itself).
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

    /// The cloud, if its sizes and fields agree. A single row needs no step to the next: whatever
    /// the message says there is replaced by the row's own length; in a cloud without points, whose
    /// other sizes may be any, by 0.
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
                "field `{}` ends at byte {end} of a point of {} bytes",
                field.name, self.point_step
            )));
        }
        Ok(())
    }

    /// All rows are there and do not overlap, so that there are no more points than bytes.
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
                "rows are {row_step} bytes apart, {width} points of {point_step} bytes take {row}"
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

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The value of one point, `index = row * width + column`; every kind fits into an `f64`
    /// exactly.
    ///
    /// # Panics
    /// If there is no such point, as a slice does.
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

    /// `N` bytes, in little-endian order.
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

    /// Two rows of two points of 3 bytes (a byte, then a word), rows 8 bytes apart.
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
    fn a_column_steps_over_the_padding_of_rows_in_both_byte_orders() {
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
    fn every_kind_reads_its_own_bytes() {
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
    fn what_contradicts_itself_is_refused() {
        let refused = |change: fn(&mut PointCloud<'_>)| {
            let mut cloud = padded(false);
            change(&mut cloud);
            assert!(cloud.column("b").is_none());
            cloud.checked().unwrap_err().to_string()
        };
        assert_eq!(
            refused(|cloud| cloud.fields[1].offset = 2),
            "point cloud layout: field `b` ends at byte 4 of a point of 3 bytes"
        );
        assert_eq!(
            refused(|cloud| cloud.row_step = 5),
            "point cloud layout: rows are 5 bytes apart, 2 points of 3 bytes take 6"
        );
        assert_eq!(
            refused(|cloud| cloud.height = 3),
            "point cloud layout: 2 x 3 points of 3 bytes do not fit into 14 bytes"
        );
        refused(|cloud| cloud.fields[1].offset = usize::MAX);
        refused(|cloud| cloud.width = usize::MAX);
        refused(|cloud| (cloud.height, cloud.row_step) = (usize::MAX, usize::MAX));
        let many_points_of_nothing =
            PointCloud { point_step: 0, row_step: 0, fields: vec![], ..padded(false) };
        assert!(many_points_of_nothing.checked().is_err());
    }

    #[test]
    fn a_single_row_needs_no_row_step() {
        for row_step in [0, 6, 7, usize::MAX] {
            let cloud = PointCloud { height: 1, row_step, ..padded(false) }.checked().unwrap();
            assert_eq!((cloud.row_step, cloud.column("b").unwrap().get(1)), (6, 1027.0));
        }
    }
}
