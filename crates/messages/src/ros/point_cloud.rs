//! `sensor_msgs/PointCloud2`. The points are borrowed.

use std::borrow::Cow;

use crate::wire::{Cursor, Decoded, Writer};
use crate::{Encoding, MessageError, MessageType, PointCloud, PointField, Result, Scalar};

/// The data type of each `PointField.datatype`, which starts at 1.
const DATATYPES: [Scalar; 8] = [
    Scalar::I8,
    Scalar::U8,
    Scalar::I16,
    Scalar::U16,
    Scalar::I32,
    Scalar::U32,
    Scalar::F32,
    Scalar::F64,
];
/// Smallest length of a `PointField` \[bytes\]: an empty name, offset, datatype and count, packed.
const MIN_FIELD_BYTES: usize = 4 + 4 + 1 + 4;

/// Reads a `sensor_msgs/PointCloud2`. Only the first element of a field with a `count` of more than 1 is
/// used.
pub(crate) fn point_cloud(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<PointCloud<'_>>> {
    let mut cursor = Cursor::new(MessageType::PointCloud2, encoding, bytes)?;
    let stamp_ns = cursor.header_stamp_ns()?;
    let height = cursor.size()?;
    let width = cursor.size()?;
    let n_fields = cursor.count(MIN_FIELD_BYTES)?;
    let fields = (0..n_fields).map(|_| read_field(&mut cursor)).collect::<Result<_>>()?;
    let big_endian = cursor.u8()? != 0;
    let point_step = cursor.size()?;
    let row_step = cursor.size()?;
    let data = Cow::Borrowed(cursor.byte_sequence()?);
    cursor.u8()?; // is_dense
    let cloud =
        PointCloud { stamp_ns, width, height, point_step, row_step, big_endian, fields, data };
    Ok(cursor.decoded(cloud.checked()?))
}

fn read_field(cursor: &mut Cursor<'_>) -> Result<PointField> {
    let name = cursor.string()?.to_owned();
    let offset = cursor.size()?;
    let datatype = cursor.u8()?;
    cursor.u32()?; // count
    let kind = usize::from(datatype).checked_sub(1).and_then(|k| DATATYPES.get(k));
    match kind {
        Some(&kind) => Ok(PointField { name, offset, kind }),
        None => Err(MessageError::CloudLayout {
            detail: format!("field `{name}` has datatype {datatype}, expected 1 to 8"),
        }),
    }
}

/// Writes a `sensor_msgs/PointCloud2`. `is_dense` is true if all floating-point fields are finite.
pub fn write_point_cloud2(encoding: Encoding, frame_id: &str, cloud: &PointCloud<'_>) -> Vec<u8> {
    let mut writer = Writer::new(encoding, 256 + frame_id.len() + cloud.data.len());
    writer.header(cloud.stamp_ns, frame_id);
    writer.size(cloud.height);
    writer.size(cloud.width);
    writer.size(cloud.fields.len());
    for field in &cloud.fields {
        let datatype = 1 + DATATYPES.iter().take_while(|&&kind| kind != field.kind).count();
        writer.string(&field.name);
        writer.size(field.offset);
        writer.u8(datatype as u8);
        writer.u32(1); // count
    }
    writer.u8(u8::from(cloud.big_endian));
    writer.size(cloud.point_step);
    writer.size(cloud.row_step);
    writer.byte_sequence(&cloud.data);
    writer.u8(u8::from(cloud.is_dense()));
    writer.finish()
}
