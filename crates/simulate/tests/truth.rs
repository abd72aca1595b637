//! Compares sensor readings with the ground truth.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may panic and prints its results"
)]

use std::collections::HashMap;
use std::io::Cursor;

use fuse::{ImuSample, InertialReading, WheelSample, fuse};
use messages::{Source, read_velodyne};
use simulate::{
    Campus, Drive, Lasers, Material, Options, PACKETS_TOPIC, Point, Surface, readings, write_drive,
};

/// No noise, no people, no mixed pixels.
fn quiet() -> Options {
    Options { range_noise_m: 0.0, dropout: 0.0, mixed_pixels: 0.0, people: 0, ..Options::default() }
}

/// A return in the map frame, decoded with the numbers of the manual only.
struct Return {
    from: [f64; 3],
    point: [f64; 3],
    range_m: f64,
    laser: usize,
}

/// The returns of every `every`-th firing of a file.
fn returns(campus: &Campus, file: u32, every: usize) -> Vec<Return> {
    let mut out = Cursor::new(Vec::new());
    write_drive(campus, 0, file, &mut out).unwrap();
    let drive = campus.drive(0);
    let options = campus.options();
    let step_deg = 360.0 * options.spin_hz * 46.08e-6;
    let mut returns = Vec::new();
    let mut firing = 0;
    for message in mcap::MessageStream::new(&out.into_inner()).unwrap() {
        let message = message.unwrap();
        if message.channel.topic != PACKETS_TOPIC {
            continue;
        }
        let schema = message.channel.schema.as_ref().unwrap();
        let source = Source::new(&schema.name, &message.channel.message_encoding).unwrap();
        for (stamp_ns, packet) in read_velodyne(source, &message.data).unwrap().packets() {
            for (block, bytes) in packet.chunks_exact(100).take(12).enumerate() {
                firing += 1;
                if firing % every != 0 {
                    continue;
                }
                let u16_at = |at: usize| f64::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
                for laser in 0..32 {
                    let range_m = u16_at(4 + 3 * laser) * 0.002;
                    if range_m <= 0.0 {
                        continue;
                    }
                    let azimuth = (u16_at(2) * 0.01 + step_deg * laser as f64 / 40.0).to_radians();
                    // -30.67 deg to 10.67 deg; even lasers are the lower half.
                    let ring = if laser % 2 == 0 { laser / 2 } else { 16 + laser / 2 };
                    let elevation = ((-92.0 + 4.0 * ring as f64) / 3.0).to_radians();
                    let mut d = [
                        elevation.cos() * azimuth.cos(),
                        -elevation.cos() * azimuth.sin(),
                        elevation.sin(),
                    ];
                    if options.upside_down {
                        d = [d[0], -d[1], -d[2]];
                    }
                    let ns = stamp_ns - 552_960 + block as i64 * 46_080 + laser as i64 * 1_152;
                    let motion = drive.motion_at(ns);
                    let (sin, cos) = motion.pitch_rad.sin_cos();
                    let d = [cos * d[0] + sin * d[2], d[1], cos * d[2] - sin * d[0]];
                    let (sin, cos) = motion.pose.heading_rad.sin_cos();
                    let d = [cos * d[0] - sin * d[1], sin * d[0] + cos * d[1], d[2]];
                    let from = motion.sensor_position_m();
                    let point = std::array::from_fn(|k| from[k] + range_m * d[k]);
                    returns.push(Return { from, point, range_m, laser });
                }
            }
        }
    }
    returns
}

/// Surfaces by the 2 m cells that they touch, including neighbouring cells.
struct Index<'a> {
    drive: &'a Drive,
    cells: HashMap<(i64, i64), Vec<&'a Surface>>,
}

const CELL_M: f64 = 2.0;

impl<'a> Index<'a> {
    fn new(drive: &'a Drive) -> Self {
        let mut cells: HashMap<_, Vec<&Surface>> = HashMap::new();
        let cell = |metres: f64| (metres / CELL_M).floor() as i64;
        for surface in drive.surfaces() {
            let (a, b) = (surface.segment.start, surface.segment.end);
            for i in cell(a.x.min(b.x)) - 1..=cell(a.x.max(b.x)) + 1 {
                for j in cell(a.y.min(b.y)) - 1..=cell(a.y.max(b.y)) + 1 {
                    cells.entry((i, j)).or_default().push(surface);
                }
            }
        }
        Self { drive, cells }
    }

    /// Distance of a point to the nearest surface, floor or ceiling. Foliage is a volume, and any
    /// point inside it has distance 0.
    fn off_m(&self, [x, y, z]: [f64; 3]) -> f64 {
        let cell = ((x / CELL_M).floor() as i64, (y / CELL_M).floor() as i64);
        let of_surface = |surface: &&Surface| {
            let aside_m = surface.segment.distance_m(Point::new(x, y));
            let above_m = (z - surface.z_high_m).max(surface.z_low_m - z).max(0.0);
            let depth_m = if surface.material == Material::Foliage { 1.3 } else { 0.0 };
            (aside_m - depth_m).max(0.0).hypot((above_m - depth_m).max(0.0))
        };
        let surfaces = self.cells.get(&cell).into_iter().flatten().map(of_surface);
        let ceiling_m = (self.drive.ceiling_m(Point::new(x, y)) - z).abs();
        surfaces.fold(z.abs().min(ceiling_m), f64::min)
    }
}

/// Largest expected distance of a return from its surface \[m\].
///
/// A packet rounds ranges to 2 mm (error up to 1 mm) and azimuths to 0.01 deg. The azimuth noise has a
/// standard deviation of 0.003 deg. Six standard deviations plus rounding are 0.023 deg, or 4e-4 rad.
/// All lasers of a firing use the heading at its middle, which adds 5e-5 rad. Range noise is at most
/// 3.46 standard deviations.
fn limit_m(range_m: f64, noise_m: f64) -> f64 {
    0.0015 + 5e-4 * range_m + 3.47 * noise_m
}

/// Returns of all lasers, outdoors and in each of seven buildings, upright and upside down, with and
/// without range noise. At a vertical edge, a beam may hit the neighbour of the surface that its
/// reported azimuth points to; a few returns are therefore allowed to be off.
#[test]
fn returns_are_on_surfaces() {
    for (upside_down, range_noise_m) in [(false, 0.0), (true, 0.0), (false, 0.004), (true, 0.004)] {
        // A fast lap around the campus; every fourth of 80 files is checked.
        let options = Options {
            buildings: 7,
            lasers: Lasers::All,
            upside_down,
            range_noise_m,
            length_m: 1700.0,
            speed_m_s: 8.0,
            files: 80,
            ..quiet()
        };
        let campus = Campus::new(&options, 2436).unwrap();
        let index = Index::new(campus.drive(0));
        let mut from_building = vec![0u64; campus.buildings().len() + 1];
        let (mut n, mut n_off, mut by_laser) = (0u64, 0u64, [0u64; 32]);
        let mut n_exact = 0u64;
        for file in (0..80).step_by(4) {
            for r in returns(&campus, file, 29) {
                let is_inside = |(low, high): &(Point, Point)| {
                    let [x, y, _] = r.from;
                    low.x < x && x < high.x && low.y < y && y < high.y
                };
                let building = campus.buildings().iter().position(is_inside);
                from_building[building.unwrap_or(campus.buildings().len())] += 1;
                by_laser[r.laser] += 1;
                n += 1;
                let off_m = index.off_m(r.point);
                n_off += u64::from(limit_m(r.range_m, range_noise_m) < off_m);
                n_exact += u64::from(off_m < limit_m(r.range_m, 0.0));
            }
        }
        assert!(from_building.iter().all(|&n| 1000 < n), "{from_building:?}");
        assert!(by_laser.iter().all(|&n| 1000 < n), "{by_laser:?}");
        println!(
            "upside down: {upside_down}, noise {range_noise_m} m: {n_off} of {n} off, {n_exact} exact, {from_building:?}"
        );
        assert!(n_off * 2000 < n, "{n_off} of {n} returns are off all surfaces");
        // With noise, some of the returns are farther off than rounding explains.
        assert!(range_noise_m <= 0.0 || n_exact * 10 < n * 9, "{n_exact} of {n} are exact");
    }
}

/// Poses fused from wheel encoders and IMU on a lap of the campus, with the default sensor errors.
#[test]
fn fused_poses_stay_within_half_a_percent_of_the_distance() {
    for (speed_m_s, seed) in [1.0, 1.5, 2.0].into_iter().flat_map(|v| [(v, 1), (v, 2436)]) {
        let options = Options { buildings: 7, length_m: 1700.0, speed_m_s, ..Options::default() };
        let campus = Campus::new(&options, seed).unwrap();
        for log in 0..2 {
            let (wheels, imu) = readings(&campus, log);
            let wheels: Vec<WheelSample> = wheels
                .iter()
                .map(|reading| WheelSample {
                    stamp_ns: reading.stamp_ns,
                    left_m_s: reading.velocities[0],
                    right_m_s: reading.velocities[1],
                })
                .collect();
            let inertial: Vec<InertialReading> = imu
                .iter()
                .map(|reading| InertialReading {
                    stamp_ns: reading.stamp_ns,
                    angular_velocity_rad_s: reading.angular_velocity,
                    acceleration_m_s2: reading.linear_acceleration,
                })
                .collect();
            let imu: Vec<ImuSample> =
                (inertial.iter().zip(fuse::yaw_rates_rad_s(&inertial, &wheels)))
                    .map(|(reading, yaw_rate_rad_s)| ImuSample {
                        stamp_ns: reading.stamp_ns,
                        yaw_rate_rad_s,
                        heading_rad: None,
                    })
                    .collect();
            let fuse_options =
                fuse::Options { track_m: options.wheels.track_m, ..fuse::Options::default() };
            let fused = fuse(&fuse_options, &wheels, &imu, None, None).unwrap();
            let drive = campus.drive(log);
            let errors_m =
                fused.poses.iter().map(|pose| pose.pose.distance_m(&drive.pose_at(pose.stamp_ns)));
            let largest_m = errors_m.fold(0.0, f64::max);
            let last = fused.poses.last().unwrap();
            let truth = drive.pose_at(last.stamp_ns);
            println!(
                "{speed_m_s} m/s, seed {seed}, log {log}: {largest_m:.2} m of 1700 m, end {:.2} m, heading {:.4} rad, wheels {:.4}, bias {:.6?}",
                last.pose.distance_m(&truth),
                dataset::wrap_angle(last.pose.heading_rad - truth.heading_rad),
                fused.report.distance_m,
                fused.report.gyro_bias_mean_rad_s
            );
            // Half a percent is 8.5 m, but labels within 1.5 m need less.
            assert!(largest_m < 1.7, "{largest_m} m");
        }
    }
}
