//! The HDL-32E: turns, fires, and packs what it measures.
//!
//! The world is 2.5-dimensional: walls, furniture and people reach from floor to ceiling, so a
//! beam ends at the nearest of wall, person, floor and ceiling above or below it. Every laser
//! fires at its own time and azimuth, from where the robot is then.
//!
//! Left out: mixed pixels at edges, reflectivity that depends on the angle, glass, jitter of the
//! spin, lost packets.

use messages::hdl32e::{
    AZIMUTH_COUNTS, BLOCK_PERIOD_NS, BLOCKS, ELEVATION_DEG, HORIZONTAL_LASER, HOUR_US, LASERS,
    METRES_PER_COUNT, PACKET_BYTES, PACKET_PERIOD_NS, PERIODS_PER_BLOCK, PacketBuilder,
};

use crate::clutter::PERSON_RADIUS_M;
use crate::drive::Drive;
use crate::random::Random;
use crate::walls::{Point, Vector, Walls, cross};
use crate::{Lasers, Options};

/// Nothing beyond this returns; data sheets of the HDL-32E promise 70 m, later ones 100 m \[m\].
pub(crate) const MAX_RANGE_M: f64 = 70.0;
/// Height of the sensor above the floor \[m\].
const SENSOR_HEIGHT_M: f64 = 0.8;
/// Height of all ceilings above the floor \[m\].
const CEILING_HEIGHT_M: f64 = 2.7;
/// People nearer to the sensor than this step aside: no ray meets them \[m\].
const STEP_ASIDE_M: f64 = 0.4;
/// Packets per second that `velodyne_driver` assumes of an HDL-32E (its `driver.cc`).
const DRIVER_PACKET_RATE_HZ: f64 = 1808.0;

/// Intensities of what is no wall; walls have 20 to 99, by segment.
const FLOOR_INTENSITY: u8 = 12;
const CEILING_INTENSITY: u8 = 110;
const PERSON_INTENSITY: u8 = 35;

/// A packet and its stamp, the end of its last block \[ns since the epoch\].
pub(crate) type StampedPacket = (i64, [u8; PACKET_BYTES]);

/// Packets in a message: as many as `velodyne_driver` counts for one turn, rounded up. Being more
/// than a turn, they move the message's border around the circle.
pub(crate) fn packets_per_message(spin_hz: f64) -> u64 {
    (DRIVER_PACKET_RATE_HZ / spin_hz).ceil() as u64
}

/// Counts of azimuth from block to block \[0.01 deg\], no whole number.
pub(crate) fn azimuth_step_counts(spin_hz: f64) -> f64 {
    spin_hz * f64::from(AZIMUTH_COUNTS) * BLOCK_PERIOD_NS as f64 * 1e-9
}

/// An HDL-32E as the options mount it.
#[derive(Debug)]
pub(crate) struct Sensor {
    spin_hz: f64,
    /// A return at azimuth a lies at y = `y_sign` r sin a: -1 for a clockwise azimuth seen from
    /// above, 1 when the sensor hangs upside down (rolled by 180 deg about x).
    y_sign: f64,
    beams: Vec<Beam>,
    range_noise_m: f64,
    dropout: f64,
}

/// One laser and where it ends if no wall is in its way.
#[derive(Debug)]
struct Beam {
    laser: usize,
    cos_elevation: f64,
    /// Horizontal distance after which a wall no longer matters \[m\].
    reach_m: f64,
    /// What is hit there, if within the sensor's range: its intensity.
    surface: Option<u8>,
}

impl Beam {
    fn new(laser: usize, is_upside_down: bool) -> Self {
        let sign = if is_upside_down { -1.0 } else { 1.0 };
        // The manual's angles in f64 leave the horizontal beam 1e-15 deg off.
        let degrees = if laser == HORIZONTAL_LASER { 0.0 } else { sign * ELEVATION_DEG[laser] };
        let (sin, cos) = libm::sincos(degrees.to_radians());
        let (height_m, intensity) = if sin < 0.0 {
            (SENSOR_HEIGHT_M, FLOOR_INTENSITY)
        } else {
            (CEILING_HEIGHT_M - SENSOR_HEIGHT_M, CEILING_INTENSITY)
        };
        let range_m = height_m / sin.abs(); // infinite for the horizontal beam
        Self {
            laser,
            cos_elevation: cos,
            reach_m: range_m.min(MAX_RANGE_M) * cos,
            surface: (range_m <= MAX_RANGE_M).then_some(intensity),
        }
    }
}

/// What one firing measures, before noise.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Echo {
    range_m: f64,
    intensity: u8,
}

impl Sensor {
    pub(crate) fn new(options: &Options) -> Self {
        let lasers = match options.lasers {
            Lasers::Three => HORIZONTAL_LASER - 1..HORIZONTAL_LASER + 2,
            Lasers::All => 0..LASERS,
        };
        Self {
            spin_hz: options.spin_hz,
            y_sign: if options.upside_down { 1.0 } else { -1.0 },
            beams: lasers.map(|laser| Beam::new(laser, options.upside_down)).collect(),
            range_noise_m: options.range_noise_m,
            dropout: options.dropout,
        }
    }

    /// The packets of one message of a drive; `random` belongs to this message alone.
    pub(crate) fn packets(
        &self,
        drive: &Drive,
        message: u64,
        random: &mut Random,
    ) -> Vec<StampedPacket> {
        let n_packets = packets_per_message(self.spin_hz);
        let first = message * n_packets;
        let packet_ns = |packet: u64| drive.first_firing_ns() + packet as i64 * PACKET_PERIOD_NS;
        // People walk straight and steadily for the tenth of a second that a message takes.
        let (from_ns, to_ns) = (packet_ns(first), packet_ns(first + n_packets));
        let crowd =
            Crowd { from_ns, to_ns, from: drive.people_at(from_ns), to: drive.people_at(to_ns) };
        (first..first + n_packets)
            .map(|packet| {
                let start_ns = packet_ns(packet);
                let bytes = self.packet(drive, packet, start_ns, &crowd, random);
                (start_ns + PACKET_PERIOD_NS, bytes)
            })
            .collect()
    }

    fn packet(
        &self,
        drive: &Drive,
        packet: u64,
        start_ns: i64,
        crowd: &Crowd,
        random: &mut Random,
    ) -> [u8; PACKET_BYTES] {
        let step = azimuth_step_counts(self.spin_hz);
        let full = f64::from(AZIMUTH_COUNTS);
        let azimuths: [f64; BLOCKS] = std::array::from_fn(|block| {
            let passed = (packet * BLOCKS as u64 + block as u64) as f64 * step;
            (drive.start_azimuth_counts() + passed).rem_euclid(full)
        });
        // The device's clock and the host's are one; the device stamps the first firing (VLP-16
        // manual 63-9243, "Time stamp"; the HDL-32E's manual does not say).
        let device_time_us = (start_ns / 1000).rem_euclid(i64::from(HOUR_US)) as u32;
        let rounded = azimuths.map(|azimuth| azimuth.round() as u16 % AZIMUTH_COUNTS);
        let mut builder = PacketBuilder::new(rounded, device_time_us);

        let mut here = drive.position_at(start_ns);
        for (block, azimuth) in azimuths.into_iter().enumerate() {
            let block_ns = start_ns + block as i64 * BLOCK_PERIOD_NS;
            let next = drive.position_at(block_ns + BLOCK_PERIOD_NS);
            let motion = BlockMotion::new(here, next, azimuth, step, self.y_sign);
            let people = crowd.near(block_ns, &motion);
            for beam in &self.beams {
                let (from, direction) = motion.at(beam.laser);
                let echo = beam.echo(drive.walls(), &people, from, direction);
                if let Some((counts, intensity)) = self.measure(echo, random) {
                    builder.set_return(block, beam.laser, counts, intensity);
                }
            }
            here = next;
        }
        builder.finish()
    }

    /// Adds dropouts and noise, rounds to the packet's counts.
    fn measure(&self, echo: Option<Echo>, random: &mut Random) -> Option<(u16, u8)> {
        let Echo { range_m, intensity } = echo?;
        if random.chance(self.dropout) {
            return None;
        }
        let noisy_m = range_m + self.range_noise_m * random.normal();
        // Float to integer saturates: below zero is zero, no return.
        let counts = (noisy_m / METRES_PER_COUNT).round() as u16;
        (0 < counts).then_some((counts, intensity))
    }
}

impl Beam {
    /// The first thing in the way of the beam from `from` along the horizontal unit vector.
    fn echo(
        &self,
        walls: &Walls,
        people: &[Point],
        from: Point,
        direction: Vector,
    ) -> Option<Echo> {
        let person = people.iter().filter_map(|&p| meet_person(p, from, direction));
        let person_m = person.fold(f64::INFINITY, f64::min);
        let limit_m = self.reach_m.min(person_m);
        let (horizontal_m, intensity) = match walls.cast(from, direction, limit_m) {
            Some(hit) => (hit.range_m, 20 + (hit.segment % 80) as u8),
            None if person_m <= self.reach_m => (person_m, PERSON_INTENSITY),
            None => (self.reach_m, self.surface?),
        };
        Some(Echo { range_m: horizontal_m / self.cos_elevation, intensity })
    }
}

/// Where the sensor is and looks during one block.
///
/// Position and direction change linearly from laser to laser; over 46 us that is exact to
/// 1e-9 m and 1e-9 rad.
struct BlockMotion {
    from: Point,
    /// Way of the robot until the next block.
    moved: Vector,
    /// Direction of the block's first firing.
    direction: Vector,
    /// Counter-clockwise turn of the beam until the next block: the spin and the robot's \[rad\].
    turned: f64,
}

impl BlockMotion {
    fn new(
        here: (Point, Vector),
        next: (Point, Vector),
        azimuth_counts: f64,
        step_counts: f64,
        y_sign: f64,
    ) -> Self {
        let rad = |counts: f64| (counts * 0.01).to_radians();
        let forward = here.1;
        let left = Vector::new(-forward.y, forward.x);
        let (sin, cos) = libm::sincos(rad(azimuth_counts));
        Self {
            from: here.0,
            moved: next.0 - here.0,
            direction: forward * cos + left * (y_sign * sin),
            // The sine of so small an angle is the angle.
            turned: y_sign * rad(step_counts) + cross(forward, next.1),
        }
    }

    /// Origin and direction of a laser's firing.
    fn at(&self, laser: usize) -> (Point, Vector) {
        let share = laser as f64 / PERIODS_PER_BLOCK as f64;
        let angle = share * self.turned;
        // Taylor series; the next terms are below 1e-13 for the 0.4 deg of a block at 20 Hz.
        let (sin, cos) = (angle - angle * angle * angle / 6.0, 1.0 - angle * angle / 2.0);
        let d = self.direction;
        let direction = Vector::new(cos * d.x - sin * d.y, sin * d.x + cos * d.y);
        (self.from + self.moved * share, direction)
    }
}

/// The people during one message.
struct Crowd {
    from_ns: i64,
    to_ns: i64,
    from: Vec<Point>,
    to: Vec<Point>,
}

impl Crowd {
    /// Those that a beam can meet during a block.
    fn near(&self, block_ns: i64, motion: &BlockMotion) -> Vec<Point> {
        let share = (block_ns - self.from_ns) as f64 / (self.to_ns - self.from_ns) as f64;
        let people = self.from.iter().zip(&self.to);
        people
            .map(|(from, to)| from + (to - from) * share)
            .filter(|person| {
                let way = person - motion.from;
                let ahead = way.dot(&motion.direction);
                // The beam turns on within the block.
                let aside = PERSON_RADIUS_M + ahead * motion.turned.abs();
                0.0 < ahead
                    && cross(motion.direction, way).abs() < aside
                    && STEP_ASIDE_M * STEP_ASIDE_M < way.norm_squared()
            })
            .collect()
    }
}

/// Range at which a ray enters the disc of a person.
fn meet_person(person: Point, from: Point, direction: Vector) -> Option<f64> {
    let way = person - from;
    let aside = cross(direction, way);
    let inside = PERSON_RADIUS_M * PERSON_RADIUS_M - aside * aside;
    (0.0 <= inside).then(|| way.dot(&direction) - inside.sqrt()).filter(|range| 0.0 < *range)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::walls::{Rect, outline};

    /// A room of 10 x 6 m; the robot in its middle looks along x.
    fn room() -> Walls {
        let (a, b) = (Point::new(-5.0, -3.0), Point::new(5.0, 3.0));
        Walls::new(outline(&[Rect::new(a, b)], &[]))
    }

    fn still() -> (Point, Vector) {
        (Point::origin(), Vector::new(1.0, 0.0))
    }

    fn range_m(laser: usize, azimuth_deg: f64, people: &[Point], is_upside_down: bool) -> f64 {
        let y_sign = if is_upside_down { 1.0 } else { -1.0 };
        let motion = BlockMotion::new(still(), still(), azimuth_deg * 100.0, 0.0, y_sign);
        let (from, direction) = motion.at(laser);
        Beam::new(laser, is_upside_down).echo(&room(), people, from, direction).unwrap().range_m
    }

    #[track_caller]
    fn check(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-4, "{found}, expected {expected}");
    }

    /// Ahead 5 m; right (azimuth 90 deg) and left 3 m; 3 / sin 45 deg = 4.2426 m.
    #[test]
    fn the_horizontal_laser_in_a_room() {
        for (azimuth_deg, expected) in
            [(0.0, 5.0), (90.0, 3.0), (180.0, 5.0), (270.0, 3.0), (45.0, 4.2426)]
        {
            check(range_m(15, azimuth_deg, &[], false), expected);
        }
    }

    /// Laser 14 looks down by 21.3333 deg: 0.8 / sin = 2.1991 m, nearer than any wall. Laser 12
    /// looks down by 22.6667 deg and laser 13 by 1.3333 deg: 3 / cos = 3.0008 m to the wall. Upside
    /// down laser 14 looks up: 1.9 m to the ceiling / sin = 5.2227 m, but 3 / cos = 3.2207 m to a
    /// side wall.
    #[test]
    fn other_lasers_meet_floor_wall_or_ceiling() {
        check(range_m(14, 0.0, &[], false), 2.1991);
        check(range_m(13, 90.0, &[], false), 3.0008);
        check(range_m(14, 0.0, &[], true), 5.2227);
        check(range_m(14, 90.0, &[], true), 3.2207);
    }

    /// A person 2 m ahead and 1 m to the left is met at azimuth 360 - 26.565 deg, at
    /// sqrt(5) - 0.25 = 1.9861 m; upside down at 26.565 deg.
    #[test]
    fn a_person_to_the_left() {
        let person = [Point::new(2.0, 1.0)];
        check(range_m(15, 333.435, &person, false), 1.9861);
        check(range_m(15, 26.565, &person, true), 1.9861);
        check(range_m(15, 26.565, &person, false), 5.5902); // 5 / cos 26.565 deg, the wall
    }

    /// Laser 15 fires 15/40 of the step after its block: at azimuth 90 deg and a step of 0.4 deg,
    /// 90.15 deg, and the robot has moved by 3 mm of the 8 to the next block.
    #[test]
    fn a_laser_fires_at_its_own_time_and_azimuth() {
        let next = (Point::new(0.008, 0.0), Vector::new(1.0, 0.0));
        let (from, direction) = BlockMotion::new(still(), next, 9000.0, 40.0, -1.0).at(15);
        check(from.x, 0.003);
        check(direction.x, -0.002618); // cos 90.15 deg
        check(direction.y, -1.0);
    }

    #[test]
    fn a_message_is_a_turn_and_a_block_step_no_whole_number() {
        assert_eq!(packets_per_message(10.0), 181);
        assert_eq!(packets_per_message(20.0), 91);
        assert!((azimuth_step_counts(10.0) - 16.5888).abs() < 1e-12);
    }
}
