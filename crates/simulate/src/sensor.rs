//! The HDL-32E: turns, fires, and packs what it measures.
//!
//! Every laser fires at its own time and azimuth, from where the robot is then and as it leans
//! then. What lies around the sensor is looked up once a block, in the [column] of its bearing; a
//! beam then meets what is in the columns before and after its own bearing, exactly.
//!
//! [column]: crate::world::World::column

use std::f64::consts::TAU;

use dataset::wrap_angle;
use messages::hdl32e::{
    AZIMUTH_COUNTS, BLOCK_PERIOD_NS, BLOCKS, ELEVATION_DEG, HORIZONTAL_LASER, HOUR_US, LASERS,
    METRES_PER_COUNT, PACKET_BYTES, PERIODS_PER_BLOCK, PacketBuilder, ReturnMode,
};
use nalgebra::Vector3;

use crate::beam::{Echo, MAX_RANGE_M, Ray, Scene};
use crate::drive::{Drive, MAX_PITCH_RAD, Motion, SENSOR_HEIGHT_M, forward};
use crate::people::PERSON_RADIUS_M;
use crate::plane::{Point, Vector, cross};
use crate::random::Random;
use crate::world::Entry;
use crate::{Lasers, Options};

/// People nearer to the sensor than this step aside: no ray meets them \[m\].
const STEP_ASIDE_M: f64 = 0.4;
/// Packets per second that `velodyne_driver` assumes of an HDL-32E (its `driver.cc`).
const DRIVER_PACKET_RATE_HZ: f64 = 1808.0;
/// Standard deviation of the azimuth that a block reports, before it is rounded \[0.01 deg\]: as on
/// a real sensor, where steps of 15.0 counts come as 14, 15 and 16 in the shares 18, 65 and 17 %, so
/// that their variance is 0.35 = 2 (0.3^2 + 1/12).
const AZIMUTH_NOISE_COUNTS: f64 = 0.3;
/// Columns before the first block and after the last: by so many blocks at most a leaning base
/// turns the bearing of a beam.
const PADDING: usize = 48;
/// The weakest return that is seen, as reflectivity x cosine / range^2: 10 % at 70 m \[1/m^2\].
const WEAKEST: f64 = 0.1 / (70.0 * 70.0);
/// Below this share of the weakest none is seen, as far above it all are.
const FADES_BY: f64 = 0.3;

/// A packet and its stamp, the end of its last block \[ns since the epoch\].
pub(crate) type StampedPacket = (i64, [u8; PACKET_BYTES]);

/// Firings of all lasers in a packet: in dual-return mode each takes two blocks.
fn firings_per_packet(options: &Options) -> usize {
    if options.dual_return { BLOCKS / 2 } else { BLOCKS }
}

/// Time that a packet's firings take \[ns\].
pub(crate) fn packet_period_ns(options: &Options) -> i64 {
    firings_per_packet(options) as i64 * BLOCK_PERIOD_NS
}

/// Packets in a message: as many as `velodyne_driver` counts for one turn, rounded up. Being more
/// than a turn, they move the message's border around the circle.
pub(crate) fn packets_per_message(options: &Options) -> u64 {
    let rate_hz = DRIVER_PACKET_RATE_HZ * (BLOCKS / firings_per_packet(options)) as f64;
    (rate_hz / options.spin_hz).ceil() as u64
}

/// Counts of azimuth from firing to firing \[0.01 deg\], no whole number.
pub(crate) fn azimuth_step_counts(spin_hz: f64) -> f64 {
    spin_hz * f64::from(AZIMUTH_COUNTS) * BLOCK_PERIOD_NS as f64 * 1e-9
}

/// An HDL-32E as the options mount it.
#[derive(Debug)]
pub(crate) struct Sensor {
    options: Options,
    /// A return at azimuth a lies at y = `y_sign` r sin a: -1 for a clockwise azimuth seen from
    /// above, 1 when the sensor hangs upside down (rolled by 180 deg about x).
    y_sign: f64,
    lasers: Vec<Laser>,
    /// Tangent of the steepest way up that a beam can take.
    steepest: f64,
    /// Azimuth from firing to firing \[rad\].
    step_rad: f64,
}

/// One laser as it is mounted.
#[derive(Debug)]
struct Laser {
    index: usize,
    /// Sine and cosine of its elevation, as it hangs.
    sin: f64,
    cos: f64,
    /// Sine and cosine of what the sensor turns by before it fires.
    turn: (f64, f64),
    /// The same as a share of the step.
    share: f64,
}

/// The packets of one message, before they are made.
struct Firings<'a> {
    drive: &'a Drive,
    /// Number of the message's first firing in the drive.
    first: u64,
    /// Where the sensor is at every firing, padded.
    places: Vec<Place>,
    /// The columns of every firing, padded: those of `k` are `entries[starts[k]..starts[k + 1]]`.
    starts: Vec<u32>,
    entries: Vec<Entry>,
    crowd: Crowd,
}

/// The sensor at one firing.
#[derive(Debug, Clone, Copy)]
struct Place {
    from: Vector3<f64>,
    heading_rad: f64,
    pitch_rad: f64,
}

impl Sensor {
    pub(crate) fn new(options: &Options) -> Self {
        let range = match options.lasers {
            Lasers::Three => HORIZONTAL_LASER - 1..HORIZONTAL_LASER + 2,
            Lasers::All => 0..LASERS,
        };
        let step_rad = azimuth_step_counts(options.spin_hz) * TAU / f64::from(AZIMUTH_COUNTS);
        let sign = if options.upside_down { -1.0 } else { 1.0 };
        let elevation_rad = |laser: usize| match laser {
            // The manual's angles in f64 leave the horizontal beam 1e-15 deg off.
            HORIZONTAL_LASER => 0.0,
            _ => sign * ELEVATION_DEG[laser].to_radians(),
        };
        let lasers: Vec<Laser> = range
            .clone()
            .map(|index| {
                let (sin, cos) = libm::sincos(elevation_rad(index));
                let share = index as f64 / PERIODS_PER_BLOCK as f64;
                Laser { index, sin, cos, turn: libm::sincos(share * step_rad), share }
            })
            .collect();
        let highest_rad = range.map(elevation_rad).fold(0.0, f64::max) + MAX_PITCH_RAD;
        Self {
            options: options.clone(),
            y_sign: -sign,
            lasers,
            steepest: libm::tan(highest_rad),
            step_rad,
        }
    }

    /// The packets of one message of a drive; `random` belongs to this message alone.
    pub(crate) fn packets(
        &self,
        drive: &Drive,
        message: u64,
        random: &mut Random,
    ) -> Vec<StampedPacket> {
        let n_packets = packets_per_message(&self.options);
        let per_packet = firings_per_packet(&self.options);
        let firings = self.firings(drive, message * n_packets * per_packet as u64, {
            n_packets as usize * per_packet
        });
        let mut packets = Vec::with_capacity(n_packets as usize);
        for packet in 0..n_packets {
            let start_ns = firing_ns(drive, firings.first + packet * per_packet as u64);
            let bytes = self.packet(&firings, packet as usize * per_packet, start_ns, random);
            if !random.chance(self.options.packet_loss) {
                packets.push((start_ns + packet_period_ns(&self.options), bytes));
            }
        }
        packets
    }

    /// Looks around at every firing of a message.
    fn firings<'a>(&self, drive: &'a Drive, first: u64, n: usize) -> Firings<'a> {
        let n_padded = n + 2 * PADDING;
        let ns = |k: usize| firing_ns(drive, first) + (k as i64 - PADDING as i64) * BLOCK_PERIOD_NS;
        // Between the ends of a packet the robot moves evenly, to 1e-7 m and 1e-7 rad.
        let mut places = Vec::with_capacity(n_padded + BLOCKS);
        let mut here = drive.motion_at(ns(0));
        for k in (0..n_padded).step_by(BLOCKS) {
            let next = drive.motion_at(ns(k + BLOCKS));
            let on_the_way = |block| Place::between(&here, &next, block as f64 / BLOCKS as f64);
            places.extend((0..BLOCKS).map(on_the_way));
            here = next;
        }
        places.truncate(n_padded);

        let mut starts = vec![0];
        let mut entries = Vec::with_capacity(4 * n_padded);
        for (k, place) in places.iter().enumerate() {
            let azimuth = self.azimuth_rad(drive, first as f64 + k as f64 - PADDING as f64);
            let bearing = place.heading_rad + self.y_sign * azimuth;
            let from = (Point::new(place.from.x, place.from.y), SENSOR_HEIGHT_M);
            let limits = (MAX_RANGE_M, self.steepest);
            drive.world().column(from, forward(bearing), limits, &mut entries);
            starts.push(entries.len() as u32);
        }
        let (from_ns, to_ns) = (ns(PADDING), ns(PADDING + n));
        let crowd = Crowd {
            // People walk straight and steadily for the tenth of a second that a message takes.
            from: drive.people_at(from_ns),
            to: drive.people_at(to_ns),
            n_firings: n,
        };
        Firings { drive, first, places, starts, entries, crowd }
    }

    /// Azimuth of the block of firing number `firing` \[rad\].
    fn azimuth_rad(&self, drive: &Drive, firing: f64) -> f64 {
        self.azimuth_counts(drive, firing) * TAU / f64::from(AZIMUTH_COUNTS)
    }

    fn azimuth_counts(&self, drive: &Drive, firing: f64) -> f64 {
        let passed = firing * azimuth_step_counts(self.options.spin_hz);
        (drive.start_azimuth_counts() + passed).rem_euclid(f64::from(AZIMUTH_COUNTS))
    }

    /// The packet that begins with the message's firing number `first`.
    fn packet(
        &self,
        firings: &Firings,
        first: usize,
        start_ns: i64,
        random: &mut Random,
    ) -> [u8; PACKET_BYTES] {
        let blocks_per_firing = BLOCKS / firings_per_packet(&self.options);
        let azimuths: [f64; BLOCKS] = std::array::from_fn(|block| {
            let firing = firings.first + (first + block / blocks_per_firing) as u64;
            self.azimuth_counts(firings.drive, firing as f64)
        });
        // The device's clock and the host's are one; the device stamps the first firing (VLP-16
        // manual 63-9243, "Time stamp"; the HDL-32E's manual does not say).
        let device_time_us = (start_ns / 1000).rem_euclid(i64::from(HOUR_US)) as u32;
        let mut read = [0; BLOCKS];
        for block in (0..BLOCKS).step_by(blocks_per_firing) {
            let counts = azimuths[block] + AZIMUTH_NOISE_COUNTS * random.normal();
            let counts = counts.round().rem_euclid(f64::from(AZIMUTH_COUNTS)) as u16;
            read[block..block + blocks_per_firing].fill(counts % AZIMUTH_COUNTS);
        }
        let mut builder = PacketBuilder::new(read, device_time_us);
        if self.options.dual_return {
            builder.set_return_mode(ReturnMode::Dual);
        }
        let mut people = Vec::new();
        for block in (0..BLOCKS).step_by(blocks_per_firing) {
            let firing = first + block / blocks_per_firing;
            let azimuth_rad = azimuths[block] * TAU / f64::from(AZIMUTH_COUNTS);
            let aim = Aim::new(firings, firing, azimuth_rad);
            firings.crowd.near(firing, &aim, self.y_sign, self.step_rad, &mut people);
            let ceiling_m =
                firings.drive.world().ceiling_m(Point::new(aim.place.from.x, aim.place.from.y));
            for laser in &self.lasers {
                let (ray, turned) = aim.ray(laser, self.y_sign);
                // In firings from the first column.
                let at = (firing + PADDING) as f64 + laser.share + turned / self.step_rad;
                let scene = Scene {
                    world: firings.drive.world(),
                    people: &people,
                    ceiling_m,
                    columns: firings.columns_around(at),
                };
                let echoes =
                    scene.echoes(&ray, self.options.mixed_pixels, self.options.dual_return, random);
                self.set_returns(&mut builder, block, laser.index, echoes, random);
            }
        }
        builder.finish()
    }

    fn set_returns(
        &self,
        builder: &mut PacketBuilder,
        block: usize,
        laser: usize,
        (first, second): (Option<Echo>, Option<Echo>),
        random: &mut Random,
    ) {
        let first = first.and_then(|echo| self.measure(&echo, random));
        if !self.options.dual_return {
            if let Some((_, counts, intensity)) = first {
                builder.set_return(block, laser, counts, intensity);
            }
            return;
        }
        let second = second.and_then(|echo| self.measure(&echo, random));
        let (Some(one), Some(other)) = (first.or(second), second.or(first)) else { return };
        // The last return, then the strongest.
        let last = if one.1 < other.1 { other } else { one };
        let strongest = if one.0 < other.0 { other } else { one };
        builder.set_return(block, laser, last.1, last.2);
        builder.set_return(block + 1, laser, strongest.1, strongest.2);
    }

    /// Adds dropouts and noise, rounds to the packet's counts: power, distance and intensity.
    #[inline]
    fn measure(&self, echo: &Echo, random: &mut Random) -> Option<(f64, u16, u8)> {
        let power = echo.reflectivity * echo.cosine / (echo.range_m * echo.range_m);
        let share = (power / WEAKEST - (1.0 - FADES_BY)) / (2.0 * FADES_BY);
        if !random.chance(share.min(1.0) * (1.0 - self.options.dropout)) {
            return None;
        }
        let noisy_m = echo.range_m + self.options.range_noise_m * random.quick_normal();
        // Float to integer saturates: below zero is zero, no return.
        let counts = (noisy_m / METRES_PER_COUNT).round() as u16;
        // Calibrated intensities tell the surface, not the distance.
        let intensity = (255.0 * echo.reflectivity * (0.5 + 0.5 * echo.cosine)).round() as u8;
        (0 < counts).then_some((power, counts, intensity.max(1)))
    }
}

/// When a firing begins \[ns\].
fn firing_ns(drive: &Drive, firing: u64) -> i64 {
    drive.first_firing_ns() + firing as i64 * BLOCK_PERIOD_NS
}

impl Place {
    fn between(here: &Motion, next: &Motion, share: f64) -> Self {
        let (a, b) = (Vector3::from(here.sensor_position_m()), next.sensor_position_m());
        let turned = wrap_angle(next.pose.heading_rad - here.pose.heading_rad);
        Self {
            from: a + (Vector3::from(b) - a) * share,
            heading_rad: here.pose.heading_rad + share * turned,
            pitch_rad: here.pitch_rad + share * (next.pitch_rad - here.pitch_rad),
        }
    }
}

impl Firings<'_> {
    fn column(&self, k: usize) -> &[Entry] {
        &self.entries[self.starts[k] as usize..self.starts[k + 1] as usize]
    }

    /// The columns just before and after a place between two firings, from the first column on.
    fn columns_around(&self, at: f64) -> (&[Entry], &[Entry]) {
        let k = (at.max(0.0) as usize).min(self.starts.len() - 3);
        (self.column(k), self.column(k + 1))
    }
}

/// Where the sensor looks during one firing.
struct Aim {
    place: Place,
    /// Way of the sensor until the next firing.
    moved: Vector3<f64>,
    /// Sines and cosines of the heading, the pitch, and the azimuth of the first laser. Heading and
    /// pitch are those of the middle of the firing: laser 15's to 1e-6 rad, and the others' to
    /// 5e-5 rad where the robot turns by 2 rad/s.
    heading: (f64, f64),
    pitch: (f64, f64),
    azimuth: (f64, f64),
}

impl Aim {
    fn new(firings: &Firings, firing: usize, azimuth_rad: f64) -> Self {
        let (place, next) =
            (firings.places[firing + PADDING], firings.places[firing + PADDING + 1]);
        // Laser 15.5 of 40.
        let middle = |a: f64, b: f64| a + 0.3875 * (b - a);
        Self {
            place,
            moved: next.from - place.from,
            heading: libm::sincos(middle(place.heading_rad, next.heading_rad)),
            pitch: libm::sincos(middle(place.pitch_rad, next.pitch_rad)),
            azimuth: libm::sincos(azimuth_rad),
        }
    }

    /// A laser's beam, and by how much azimuth the pitch turns its bearing, about \[rad\].
    #[inline]
    fn ray(&self, laser: &Laser, y_sign: f64) -> (Ray, f64) {
        let (sin, cos) = self.azimuth;
        let (sin, cos) =
            (sin * laser.turn.1 + cos * laser.turn.0, cos * laser.turn.1 - sin * laser.turn.0);
        // In the sensor's frame, upright: x forward, y left.
        let (x, y, z) = (laser.cos * cos, y_sign * laser.cos * sin, laser.sin);
        let (pitch_sin, pitch_cos) = self.pitch;
        let (x, z) = (x * pitch_cos + z * pitch_sin, z * pitch_cos - x * pitch_sin);
        let (heading_sin, heading_cos) = self.heading;
        let direction =
            Vector3::new(x * heading_cos - y * heading_sin, x * heading_sin + y * heading_cos, z);
        let from = self.place.from + self.moved * laser.share;
        // Small angles: tan(elevation) x pitch, across the beam.
        let turned = -sin * pitch_sin * laser.sin / laser.cos;
        (Ray { from, direction }, turned)
    }
}

/// The people during one message.
struct Crowd {
    from: Vec<Point>,
    to: Vec<Point>,
    n_firings: usize,
}

impl Crowd {
    /// Those that a beam can meet during a firing.
    fn near(&self, firing: usize, aim: &Aim, y_sign: f64, step_rad: f64, near: &mut Vec<Point>) {
        near.clear();
        let share = firing as f64 / self.n_firings as f64;
        let (sin, cos) = aim.azimuth;
        let (heading_sin, heading_cos) = aim.heading;
        let y = y_sign * sin;
        let direction =
            Vector::new(cos * heading_cos - y * heading_sin, cos * heading_sin + y * heading_cos);
        let from = Point::new(aim.place.from.x, aim.place.from.y);
        // The sensor turns on within the firing, and the pitch turns steep beams.
        let slack = step_rad + aim.pitch.0.abs();
        near.extend(self.from.iter().zip(&self.to).map(|(a, b)| a + (b - a) * share).filter(
            |person| {
                let way = person - from;
                let ahead = way.dot(&direction);
                0.0 < ahead
                    && ahead < MAX_RANGE_M
                    && cross(direction, way).abs() < PERSON_RADIUS_M + ahead * slack
                    && STEP_ASIDE_M * STEP_ASIDE_M < way.norm_squared()
            },
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_a_turn_and_a_firing_no_whole_number_of_counts() {
        let options = |spin_hz, dual_return| Options { spin_hz, dual_return, ..Options::default() };
        assert_eq!(packets_per_message(&options(10.0, false)), 181);
        assert_eq!(packets_per_message(&options(20.0, false)), 91);
        assert_eq!(packets_per_message(&options(10.0, true)), 362);
        assert_eq!(packet_period_ns(&options(10.0, true)), 276_480);
        assert!((azimuth_step_counts(10.0) - 16.5888).abs() < 1e-12);
    }

    /// Level, heading along x, azimuth 90 deg: to the right. Laser 15 fires 15/40 of the step of
    /// 0.16589 deg later. Leaning forward by 0.1 rad, a beam ahead and up by 10.667 deg points up
    /// by 0.18617 - 0.1 rad; one aside keeps its elevation, nearly, and is turned by tan x pitch.
    #[test]
    fn a_laser_fires_at_its_own_azimuth_and_leans_with_the_base() {
        let sensor = Sensor::new(&Options { lasers: Lasers::All, ..Options::default() });
        let aim = |azimuth_deg: f64, pitch: f64| Aim {
            place: Place { from: Vector3::zeros(), heading_rad: 0.0, pitch_rad: pitch },
            moved: Vector3::zeros(),
            heading: (0.0, 1.0),
            pitch: libm::sincos(pitch),
            azimuth: libm::sincos(azimuth_deg.to_radians()),
        };
        let (ray, turned) = aim(90.0, 0.0).ray(&sensor.lasers[15], -1.0);
        let late = (0.165_888f64 * 15.0 / 40.0).to_radians();
        assert!((ray.direction - Vector3::new(-late, -1.0, 0.0)).norm() < 1e-6);
        assert_eq!(turned, 0.0);
        // Laser 31 is the highest.
        let (ray, _) = aim(-0.165_888 * 31.0 / 40.0, 0.1).ray(&sensor.lasers[31], -1.0);
        assert!((libm::asin(ray.direction.z) - (0.186_17 - 0.1)).abs() < 1e-4);
        let (ray, turned) = aim(90.0 - 0.165_888 * 31.0 / 40.0, 0.1).ray(&sensor.lasers[31], -1.0);
        let azimuth = libm::atan2(-ray.direction.y, ray.direction.x);
        assert!((azimuth - 90f64.to_radians() - turned).abs() < 1e-4, "{azimuth} {turned}");
        assert!((turned + 0.1 * libm::tan(0.186_17)).abs() < 1e-3, "{turned}");
    }
}
