//! Parses the NMEA sentence of a position packet.
//!
//! Sources: HDL-32E User's Manual 63-9113, "Position packet", and NMEA 0183. A position packet has
//! 512 bytes. The `$GPRMC` sentence of the GPS receiver starts at byte 206 and is followed by zeros.
//! The whole packet is searched for the sentence, because other firmware puts it at another byte.

use crate::record::Fix;

/// The content of a position packet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Position {
    Fix(Fix),
    /// There is no sentence (no receiver is attached), or the sentence is void.
    NoFix,
    /// The checksum or a field of the sentence is wrong.
    Damaged,
}

/// Parses the `RMC` sentence of a position packet.
pub(super) fn of_packet(payload: &[u8]) -> Position {
    let starts = payload.windows(6).position(|w| w.starts_with(b"$G") && w.ends_with(b"RMC"));
    let Some(start) = starts else { return Position::NoFix };
    let sentence = &payload[start + 1..];
    let end = sentence.iter().position(|&b| matches!(b, b'\r' | b'\n' | 0));
    match std::str::from_utf8(&sentence[..end.unwrap_or(sentence.len())]) {
        Ok(sentence) => of_sentence(sentence).unwrap_or(Position::Damaged),
        Err(_) => Position::Damaged,
    }
}

/// `GPRMC,time,status,latitude,N|S,longitude,E|W,...*checksum`. Returns `None` if the sentence is
/// damaged.
fn of_sentence(sentence: &str) -> Option<Position> {
    let (body, checksum) = sentence.split_once('*')?;
    let computed = body.bytes().fold(0, |sum, byte| sum ^ byte);
    if u8::from_str_radix(checksum.trim(), 16).ok()? != computed {
        return None;
    }
    let fields: Vec<_> = body.split(',').collect();
    let [_, _, status, latitude, north, longitude, east, ..] = fields[..] else { return None };
    if status == "V" {
        return Some(Position::NoFix);
    }
    let latitude = degrees(latitude, 2)? * sign(north, "N", "S")?;
    let longitude = degrees(longitude, 3)? * sign(east, "E", "W")?;
    let on_earth = latitude.abs() <= 90.0 && longitude.abs() <= 180.0;
    // An RMC sentence has no altitude.
    let fix = Fix { latitude, longitude, altitude: f64::NAN };
    (status == "A" && on_earth).then_some(Position::Fix(fix))
}

/// Parses `ddmm.mmmm`, or `dddmm.mmmm` for `n_digits` of 3 \[deg\].
fn degrees(text: &str, n_digits: usize) -> Option<f64> {
    let minutes: f64 = text.get(n_digits..)?.parse().ok()?;
    let degrees: u16 = text.get(..n_digits)?.parse().ok()?;
    (0.0..60.0).contains(&minutes).then(|| f64::from(degrees) + minutes / 60.0)
}

fn sign(text: &str, positive: &str, negative: &str) -> Option<f64> {
    match text {
        _ if text == positive => Some(1.0),
        _ if text == negative => Some(-1.0),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(sentence: &str) -> Vec<u8> {
        let mut packet = vec![0; 512];
        packet[206..206 + sentence.len()].copy_from_slice(sentence.as_bytes());
        packet
    }

    /// A published example with its checksum: 48 deg 07.038' N, 11 deg 31.000' E.
    #[test]
    fn a_fix_is_converted_to_degrees() {
        let sentence = "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n";
        let Position::Fix(fix) = of_packet(&packet(sentence)) else { panic!() };
        assert!((fix.latitude - 48.117_3).abs() < 1e-9, "{fix:?}");
        assert!((fix.longitude - 11.516_666_666).abs() < 1e-8, "{fix:?}");
        assert!(fix.altitude.is_nan());
    }

    #[test]
    fn a_void_sentence_is_not_a_fix_and_a_wrong_checksum_is_damage() {
        assert_eq!(of_packet(&packet("$GPRMC,000000,V,,,,,,,230394,,*3E\r\n")), Position::NoFix);
        assert_eq!(of_packet(&packet("")), Position::NoFix);
        let wrong = "$GPRMC,123519,A,4807.038,S,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n";
        assert_eq!(of_packet(&packet(wrong)), Position::Damaged);
        assert_eq!(of_packet(&packet("$GPRMC,123519,A,48")), Position::Damaged);
    }
}
