//! Parses the body of an MCAP record with the `mcap` crate.
//!
//! The `mcap` crate trusts the lengths in a record. For example, it allocates 4 GB for a string if
//! the length field says so. This module checks the lengths first.

use mcap::records::{Record, op};

/// A part of the body of a record.
enum Part {
    /// This many bytes.
    Fixed(usize),
    /// A u32 length and this many bytes: a string, an array or a map of numbers.
    Counted,
    /// The same, containing pairs of strings, each with its own length.
    Strings,
}

use Part::{Counted, Fixed, Strings};

/// The parts of a record up to its last length field (MCAP specification, "Records"). `None` for
/// kinds of records that are not used.
fn parts(opcode: u8) -> Option<&'static [Part]> {
    Some(match opcode {
        op::SCHEMA => &[Fixed(2), Counted, Counted, Counted],
        op::CHANNEL => &[Fixed(4), Counted, Counted, Strings],
        op::MESSAGE => &[Fixed(22)],
        op::CHUNK => &[Fixed(28), Counted],
        op::CHUNK_INDEX => &[Fixed(32), Counted, Fixed(8), Counted],
        op::ATTACHMENT_INDEX => &[Fixed(40), Counted, Counted],
        op::STATISTICS => &[Fixed(42), Counted],
        op::METADATA_INDEX => &[Fixed(16), Counted],
        op::SUMMARY_OFFSET => &[Fixed(17)],
        op::FOOTER => &[Fixed(20)],
        _ => return None,
    })
}

/// Whether all lengths in a record fit into its body.
pub(crate) fn is_sound(opcode: u8, body: &[u8]) -> bool {
    fn counted(rest: &[u8]) -> Option<(&[u8], &[u8])> {
        let (length, rest) = rest.split_first_chunk::<4>()?;
        rest.split_at_checked(u32::from_le_bytes(*length) as usize)
    }
    let mut rest = body;
    let mut take = |part: &Part| {
        let (within, after) = match part {
            Fixed(n) => rest.split_at_checked(*n)?,
            Counted | Strings => counted(rest)?,
        };
        rest = after;
        if let Strings = part {
            let mut pairs = within;
            while !pairs.is_empty() {
                let (_key, value) = counted(pairs)?;
                (_, pairs) = counted(value)?;
            }
        }
        Some(())
    };
    parts(opcode).is_some_and(|parts| parts.iter().all(|part| take(part).is_some()))
}

/// Parses a record. `None` if its body is malformed or its kind is not used.
pub(crate) fn parse(opcode: u8, body: &[u8]) -> Option<Record<'_>> {
    match is_sound(opcode, body) {
        true => mcap::parse_record(opcode, body).ok(),
        false => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(text: &str) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
    }

    /// A hand-made channel: id 1, schema 2, topic, encoding, one pair of metadata.
    fn channel() -> Vec<u8> {
        let pair = [counted("k"), counted("v")].concat();
        let map = [(pair.len() as u32).to_le_bytes().to_vec(), pair].concat();
        [vec![1, 0, 2, 0], counted("/scan"), counted("cdr"), map].concat()
    }

    #[test]
    fn a_record_with_correct_lengths_is_parsed() {
        let Some(Record::Channel(found)) = parse(op::CHANNEL, &channel()) else { panic!() };
        assert_eq!((found.id, found.schema_id, found.topic.as_str()), (1, 2, "/scan"));
        assert_eq!(found.metadata["k"], "v");
    }

    /// Each length in turn is set to 4 GB, or to the length of the whole record. Each truncated record
    /// lacks something.
    #[test]
    fn a_length_beyond_the_body_is_rejected() {
        let whole = channel();
        // topic, encoding, map, key, value
        for at in [4, 4 + 9, 4 + 9 + 7, 4 + 9 + 7 + 4, 4 + 9 + 7 + 4 + 5] {
            for claim in [u32::MAX, whole.len() as u32] {
                let mut wrong = whole.clone();
                wrong[at..at + 4].copy_from_slice(&claim.to_le_bytes());
                assert!(!is_sound(op::CHANNEL, &wrong), "{claim} at {at}");
            }
        }
        assert!((0..whole.len()).all(|cut| !is_sound(op::CHANNEL, &whole[..cut])));
    }

    /// The `mcap` crate panics on an attachment that ends within its own header.
    #[test]
    fn a_record_of_an_unused_kind_is_not_parsed() {
        for opcode in [0, op::HEADER, op::ATTACHMENT, op::METADATA, op::MESSAGE_INDEX, 0x80] {
            assert!(parse(opcode, &[0; 40]).is_none());
        }
    }
}
