//! The simulated HDL-32E: rotation, firings and packets.
//!
//! Every laser fires at its own time and azimuth, from the pose and pitch of the robot at that time.
//! The surroundings are looked up once per block, in the [column] of its bearing. Each beam is then
//! intersected exactly with the surfaces of the columns before and after its own bearing.
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

/// People nearer to the sensor than this are ignored, as if they had stepped aside \[m\].
const MIN_PERSON_DISTANCE_M: f64 = 0.4;
/// Packet rate that `velodyne_driver` assumes for an HDL-32E (in `driver.cc`).
const DRIVER_PACKET_RATE_HZ: f64 = 1808.0;
/// Standard deviation of the azimuth that a block reports, before rounding \[0.01 deg\]. On a real
/// sensor, steps of 15.0 counts are reported as 14, 15 and 16 counts in 18, 65 and 17 % of the cases.
/// Their variance is 0.35 = 2 (0.3^2 + 1/12).
const AZIMUTH_NOISE_COUNTS: f64 = 0.3;
/// Number of columns before the first block and after the last. The pitch of the base changes the
/// bearing of a beam by at most this many blocks.
const PADDING: usize = 48;
/// Detection limit as reflectivity x cosine / range^2: 10 % at 70 m \[1/m^2\].
const DETECTION_LIMIT: f64 = 0.1 / (70.0 * 70.0);
/// The detection probability rises from 0 to 1 within this fraction below and above the limit.
const FADE_SHARE: f64 = 0.3;

/// A packet and its stamp, which is the end of its last block \[ns since the epoch\].
pub(crate) type StampedPacket = (i64, [u8; PACKET_BYTES]);

/// Number of firings of all lasers per packet. In dual-return mode each firing takes two blocks.
fn firings_per_packet(options: &Options) -> usize {
    if options.dual_return { BLOCKS / 2 } else { BLOCKS }
}

/// Duration of the firings of a packet \[ns\].
pub(crate) fn packet_period_ns(options: &Options) -> i64 {
    firings_per_packet(options) as i64 * BLOCK_PERIOD_NS
}

/// Number of packets per message: as many as `velodyne_driver` counts for one revolution, rounded up.
/// This is slightly more than a revolution, so each message starts at a later azimuth.
pub(crate) fn packets_per_message(options: &Options) -> u64 {
    let rate_hz = DRIVER_PACKET_RATE_HZ * (BLOCKS / firings_per_packet(options)) as f64;
    (rate_hz / options.spin_hz).ceil() as u64
}

/// Azimuth between two firings \[0.01 deg\]. It is not a whole number.
pub(crate) fn azimuth_step_counts(spin_hz: f64) -> f64 {
    spin_hz * f64::from(AZIMUTH_COUNTS) * BLOCK_PERIOD_NS as f64 * 1e-9
}

/// An HDL-32E, mounted as the options say.
#[derive(Debug)]
pub(crate) struct Sensor {
    options: Options,
    /// A return at azimuth a is at y = `y_sign` r sin a. The sign is -1 for an upright sensor, whose
    /// azimuth is clockwise seen from above, and 1 for one upside down (rolled by 180 deg about x).
    y_sign: f64,
    lasers: Vec<Laser>,
    /// Tangent of the largest elevation of a beam.
    steepest: f64,
    /// Azimuth between two firings \[rad\].
    step_rad: f64,
}

/// One laser, as mounted.
#[derive(Debug)]
struct Laser {
    index: usize,
    /// Sine and cosine of its elevation, as mounted.
    sin: f64,
    cos: f64,
    /// Sine and cosine of the rotation of the sensor from the start of the firing to this laser.
    rotation: (f64, f64),
    /// The same rotation as a fraction of the step between two firings.
    share: f64,
}

/// The poses and surroundings of the sensor during one message.
struct Firings<'a> {
    drive: &'a Drive,
    /// Index of the first firing of the message within the drive.
    first: u64,
    /// Pose of the sensor at every firing, with padding.
    poses: Vec<SensorPose>,
    /// The columns of every firing, with padding. Column `k` is `entries[starts[k]..starts[k + 1]]`.
    starts: Vec<u32>,
    entries: Vec<Entry>,
    crowd: Crowd,
}

/// Pose of the sensor at one firing.
#[derive(Debug, Clone, Copy)]
struct SensorPose {
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
            // In f64 the angle from the manual is off by 1e-15 deg.
            HORIZONTAL_LASER => 0.0,
            _ => sign * ELEVATION_DEG[laser].to_radians(),
        };
        let lasers: Vec<Laser> = range
            .clone()
            .map(|index| {
                let (sin, cos) = libm::sincos(elevation_rad(index));
                let share = index as f64 / PERIODS_PER_BLOCK as f64;
                Laser { index, sin, cos, rotation: libm::sincos(share * step_rad), share }
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

    /// The packets of one message of a drive. `random` is the stream of this message.
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

    /// The pose and the column at every firing of a message.
    fn firings<'a>(&self, drive: &'a Drive, first: u64, n: usize) -> Firings<'a> {
        let n_padded = n + 2 * PADDING;
        let ns = |k: usize| firing_ns(drive, first) + (k as i64 - PADDING as i64) * BLOCK_PERIOD_NS;
        // Linear interpolation within a packet is accurate to 1e-7 m and 1e-7 rad.
        let mut poses = Vec::with_capacity(n_padded + BLOCKS);
        let mut here = drive.motion_at(ns(0));
        for k in (0..n_padded).step_by(BLOCKS) {
            let next = drive.motion_at(ns(k + BLOCKS));
            let interpolate =
                |block| SensorPose::between(&here, &next, block as f64 / BLOCKS as f64);
            poses.extend((0..BLOCKS).map(interpolate));
            here = next;
        }
        poses.truncate(n_padded);

        let mut starts = vec![0];
        let mut entries = Vec::with_capacity(4 * n_padded);
        for (k, pose) in poses.iter().enumerate() {
            let azimuth = self.azimuth_rad(drive, first as f64 + k as f64 - PADDING as f64);
            let bearing = pose.heading_rad + self.y_sign * azimuth;
            let from = (Point::new(pose.from.x, pose.from.y), SENSOR_HEIGHT_M);
            let limits = (MAX_RANGE_M, self.steepest);
            drive.world().column(from, forward(bearing), limits, &mut entries);
            starts.push(entries.len() as u32);
        }
        let (from_ns, to_ns) = (ns(PADDING), ns(PADDING + n));
        let crowd = Crowd {
            // Within the tenth of a second of a message, people walk straight at constant speed.
            from: drive.people_at(from_ns),
            to: drive.people_at(to_ns),
            n_firings: n,
        };
        Firings { drive, first, poses, starts, entries, crowd }
    }

    /// Azimuth of the block of a firing \[rad\].
    fn azimuth_rad(&self, drive: &Drive, firing: f64) -> f64 {
        self.azimuth_counts(drive, firing) * TAU / f64::from(AZIMUTH_COUNTS)
    }

    fn azimuth_counts(&self, drive: &Drive, firing: f64) -> f64 {
        let passed = firing * azimuth_step_counts(self.options.spin_hz);
        (drive.start_azimuth_counts() + passed).rem_euclid(f64::from(AZIMUTH_COUNTS))
    }

    /// The packet that starts with firing `first` of the message.
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
        // The clocks of the device and the host agree. The device stamps the first firing (VLP-16
        // manual 63-9243, "Time stamp"; the HDL-32E manual does not specify it).
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
                firings.drive.world().ceiling_m(Point::new(aim.pose.from.x, aim.pose.from.y));
            for laser in &self.lasers {
                let (ray, turned) = aim.ray(laser, self.y_sign);
                // In firings since the first column.
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
        // The first block has the last return, the second block the strongest.
        let last = if one.1 < other.1 { other } else { one };
        let strongest = if one.0 < other.0 { other } else { one };
        builder.set_return(block, laser, last.1, last.2);
        builder.set_return(block + 1, laser, strongest.1, strongest.2);
    }

    /// Applies dropouts, noise and rounding: power, distance and intensity of a return.
    #[inline]
    fn measure(&self, echo: &Echo, random: &mut Random) -> Option<(f64, u16, u8)> {
        let power = echo.reflectivity * echo.cosine / (echo.range_m * echo.range_m);
        let share = (power / DETECTION_LIMIT - (1.0 - FADE_SHARE)) / (2.0 * FADE_SHARE);
        if !random.chance(share.min(1.0) * (1.0 - self.options.dropout)) {
            return None;
        }
        let noisy_m = echo.range_m + self.options.range_noise_m * random.fast_normal();
        // The conversion saturates: negative becomes zero, which means no return.
        let counts = (noisy_m / METRES_PER_COUNT).round() as u16;
        // Calibrated intensities depend on the surface, not on the distance.
        let intensity = (255.0 * echo.reflectivity * (0.5 + 0.5 * echo.cosine)).round() as u8;
        (0 < counts).then_some((power, counts, intensity.max(1)))
    }
}

/// Start of a firing \[ns\].
fn firing_ns(drive: &Drive, firing: u64) -> i64 {
    drive.first_firing_ns() + firing as i64 * BLOCK_PERIOD_NS
}

impl SensorPose {
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

    /// The columns just before and after `at`, in firings since the first column.
    fn columns_around(&self, at: f64) -> (&[Entry], &[Entry]) {
        let k = (at.max(0.0) as usize).min(self.starts.len() - 3);
        (self.column(k), self.column(k + 1))
    }
}

/// Pose and azimuth of the sensor during one firing.
struct Aim {
    pose: SensorPose,
    /// Movement of the sensor until the next firing.
    moved: Vector3<f64>,
    /// Sines and cosines of the heading, the pitch, and the azimuth of the first laser. Heading and
    /// pitch are those at the middle of the firing. They are accurate to 1e-6 rad for laser 15, and to
    /// 5e-5 rad for the others when the robot turns at 2 rad/s.
    heading: (f64, f64),
    pitch: (f64, f64),
    azimuth: (f64, f64),
}

impl Aim {
    fn new(firings: &Firings, firing: usize, azimuth_rad: f64) -> Self {
        let (pose, next) = (firings.poses[firing + PADDING], firings.poses[firing + PADDING + 1]);
        // Laser 15.5 of 40 firing periods.
        let middle = |a: f64, b: f64| a + 0.3875 * (b - a);
        Self {
            pose,
            moved: next.from - pose.from,
            heading: libm::sincos(middle(pose.heading_rad, next.heading_rad)),
            pitch: libm::sincos(middle(pose.pitch_rad, next.pitch_rad)),
            azimuth: libm::sincos(azimuth_rad),
        }
    }

    /// The beam of a laser, and the approximate change of its bearing by the pitch \[rad\].
    #[inline]
    fn ray(&self, laser: &Laser, y_sign: f64) -> (Ray, f64) {
        let (sin, cos) = self.azimuth;
        let (sin, cos) = (
            sin * laser.rotation.1 + cos * laser.rotation.0,
            cos * laser.rotation.1 - sin * laser.rotation.0,
        );
        // In the upright sensor frame: x forward, y left.
        let (x, y, z) = (laser.cos * cos, y_sign * laser.cos * sin, laser.sin);
        let (pitch_sin, pitch_cos) = self.pitch;
        let (x, z) = (x * pitch_cos + z * pitch_sin, z * pitch_cos - x * pitch_sin);
        let (heading_sin, heading_cos) = self.heading;
        let direction =
            Vector3::new(x * heading_cos - y * heading_sin, x * heading_sin + y * heading_cos, z);
        let from = self.pose.from + self.moved * laser.share;
        // For small angles: tan(elevation) x pitch, across the beam.
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
    /// Collects the people that a beam can hit during a firing.
    fn near(&self, firing: usize, aim: &Aim, y_sign: f64, step_rad: f64, near: &mut Vec<Point>) {
        near.clear();
        let share = firing as f64 / self.n_firings as f64;
        let (sin, cos) = aim.azimuth;
        let (heading_sin, heading_cos) = aim.heading;
        let y = y_sign * sin;
        let direction =
            Vector::new(cos * heading_cos - y * heading_sin, cos * heading_sin + y * heading_cos);
        let from = Point::new(aim.pose.from.x, aim.pose.from.y);
        // The sensor rotates during the firing, and the pitch changes the bearing of steep beams.
        let slack = step_rad + aim.pitch.0.abs();
        near.extend(self.from.iter().zip(&self.to).map(|(a, b)| a + (b - a) * share).filter(
            |person| {
                let to_person = person - from;
                let ahead = to_person.dot(&direction);
                0.0 < ahead
                    && ahead < MAX_RANGE_M
                    && cross(direction, to_person).abs() < PERSON_RADIUS_M + ahead * slack
                    && MIN_PERSON_DISTANCE_M * MIN_PERSON_DISTANCE_M < to_person.norm_squared()
            },
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_covers_one_revolution_and_the_azimuth_step_is_fractional() {
        let options = |spin_hz, dual_return| Options { spin_hz, dual_return, ..Options::default() };
        assert_eq!(packets_per_message(&options(10.0, false)), 181);
        assert_eq!(packets_per_message(&options(20.0, false)), 91);
        assert_eq!(packets_per_message(&options(10.0, true)), 362);
        assert_eq!(packet_period_ns(&options(10.0, true)), 276_480);
        assert!((azimuth_step_counts(10.0) - 16.5888).abs() < 1e-12);
    }

    /// Level base, heading along x: azimuth 90 deg points to the right. Laser 15 fires 15/40 of the
    /// step of 0.16589 deg later. With a pitch of 0.1 rad, a forward beam up by 10.667 deg points up
    /// by 0.18617 - 0.1 rad. A sideways beam keeps its elevation approximately, and its bearing
    /// changes by tan(elevation) x pitch.
    #[test]
    fn a_laser_fires_at_its_own_azimuth_and_pitches_with_the_base() {
        let sensor = Sensor::new(&Options { lasers: Lasers::All, ..Options::default() });
        let aim = |azimuth_deg: f64, pitch: f64| Aim {
            pose: SensorPose { from: Vector3::zeros(), heading_rad: 0.0, pitch_rad: pitch },
            moved: Vector3::zeros(),
            heading: (0.0, 1.0),
            pitch: libm::sincos(pitch),
            azimuth: libm::sincos(azimuth_deg.to_radians()),
        };
        let (ray, turned) = aim(90.0, 0.0).ray(&sensor.lasers[15], -1.0);
        let late = (0.165_888f64 * 15.0 / 40.0).to_radians();
        assert!((ray.direction - Vector3::new(-late, -1.0, 0.0)).norm() < 1e-6);
        assert_eq!(turned, 0.0);
        // Laser 31 has the largest elevation.
        let (ray, _) = aim(-0.165_888 * 31.0 / 40.0, 0.1).ray(&sensor.lasers[31], -1.0);
        assert!((libm::asin(ray.direction.z) - (0.186_17 - 0.1)).abs() < 1e-4);
        let (ray, turned) = aim(90.0 - 0.165_888 * 31.0 / 40.0, 0.1).ray(&sensor.lasers[31], -1.0);
        let azimuth = libm::atan2(-ray.direction.y, ray.direction.x);
        assert!((azimuth - 90f64.to_radians() - turned).abs() < 1e-4, "{azimuth} {turned}");
        assert!((turned + 0.1 * libm::tan(0.186_17)).abs() < 1e-3, "{turned}");
    }
}
