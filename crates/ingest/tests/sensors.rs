//! Tests of each sensor and each option on logs made in memory. Expected values are computed by hand.

mod common;

use std::borrow::Cow;
use std::io::Cursor;

use common::packets::{
    PACKETS_PER_REVOLUTION, START_NS, STEP, Stamped, around, device_us, packets_log, set_device_us,
    stream,
};
use common::{Entry, codes, ingest_bytes, ingest_files, options, planar_log, small_chunks, write};
use dataset::{Note, NoteKind, Scan};
use ingest::{Clock, IngestError, Ingested, LidarOptions, Options};
use mcap::WriteOptions;
use mcap::records::MessageHeader;
use messages::hdl32e::{BLOCKS, HOUR_US, PacketBuilder, ReturnMode};
use messages::{Encoding, PointCloud, PointField, Scalar, ros};

type Output = Result<(Vec<Scan>, Ingested), IngestError>;

fn ingest(entries: &[Entry], mut lidar: LidarOptions) -> Output {
    lidar.topic = entries[0].0.to_owned();
    lidar.check().expect("valid options");
    ingest_bytes(&write(entries, small_chunks()), &Options { lidar, pose: None })
}

fn scans(packets: &[Stamped], lidar: LidarOptions) -> (Vec<Scan>, Ingested) {
    ingest(&packets_log(packets), lidar).expect("an intact log")
}

fn assert_error(output: Output, texts: &[&str]) {
    let message = output.expect_err("an error").to_string();
    for text in texts {
        assert!(message.contains(text), "`{text}` is not in: {message}");
    }
}

fn kinds(ingested: &Ingested) -> Vec<&NoteKind> {
    ingested.notes.iter().map(|note: &Note| &note.kind).collect()
}

fn default() -> LidarOptions {
    LidarOptions::default()
}

fn close(a: f32, b: f64) -> bool {
    (f64::from(a) - b).abs() < 1e-5
}

// Beams ------------------------------------------------------------------------------------------

#[test]
fn a_laser_without_returns_is_an_error_that_lists_the_others() {
    let horizontal_dead =
        stream(310, |_, laser| [0, 700][usize::from([14, 16, 31].contains(&laser))]);
    assert_error(
        ingest(&packets_log(&horizontal_dead), default()),
        &[
            "laser 15 (in firing order, 0.00 deg) of topic `/packets` has no return in 3600 firings",
            "set `ingest.lidar.laser` to a laser with returns (14, 16, 31)",
        ],
    );
    // Laser 11 is dead, as in the real capture. It is selected by its ring.
    let dead_11 = stream(310, |_, laser| if laser == 11 { 0 } else { 700 });
    assert_error(
        ingest(&packets_log(&dead_11), LidarOptions { ring: Some(21), ..default() }),
        &["laser 11 (in firing order, -2.67 deg)", "a laser with returns (0-10, 12-31)"],
    );
    let (found, ingested) = scans(&dead_11, default());
    assert_eq!((found.len(), ingested.losses.is_empty()), (2, true));
    let (n_returning, n_lasers) = (31, 32);
    let silent = NoteKind::SilentLasers { n_returning, n_lasers, silent: "11".to_owned() };
    assert_eq!(kinds(&ingested).last().unwrap(), &&silent);
}

/// A range of 10 m at elevation e is 10 cos e in the plane: cos 30.667 deg = 0.860149, cos 9.333 deg =
/// 0.986762, cos 10.667 deg = 0.982721. Laser k fires k x 1.152 us and k/40 x 0.2 deg into its block.
#[test]
fn laser_ring_and_elevation_select_the_same_beam() {
    let packets = stream(310, |_, laser| 5000 + laser as u16);
    for (laser, ring, elevation_deg, cosine) in [
        (0, 0, -30.67, 0.860_149),
        (1, 16, -9.33, 0.986_762),
        (15, 23, 0.0, 1.0),
        (15, 23, 0.65, 1.0),
        (31, 31, 10.67, 0.982_721),
        (31, 31, 11.3, 0.982_721),
    ] {
        let of_laser = scans(&packets, LidarOptions { laser: Some(laser), ..default() });
        let of_ring = scans(&packets, LidarOptions { ring: Some(ring), ..default() });
        let elevation_deg = Some(elevation_deg);
        let of_elevation = scans(&packets, LidarOptions { elevation_deg, ..default() });
        assert_eq!(of_laser, of_ring);
        assert_eq!(of_laser, of_elevation);
        let scan = &of_laser.0[0];
        assert_eq!((scan.len(), scan.stamp_ns), (1800, START_NS + i64::from(laser) * 1152));
        let planar_m = (10.0 + 0.002 * f64::from(laser)) * cosine;
        let azimuth = (f64::from(laser) / 40.0 * 0.2f64).to_radians();
        assert!(close(scan.x_m[0], planar_m * azimuth.cos()), "{laser}: {}", scan.x_m[0]);
        assert!(close(scan.y_m[0], -planar_m * azimuth.sin()), "{laser}: {}", scan.y_m[0]);
        // A quarter of a revolution later, to the right.
        assert!(close(scan.y_m[450], -planar_m * azimuth.cos()), "{laser}: {}", scan.y_m[450]);
    }
    assert_eq!(
        scans(&packets, default()),
        scans(&packets, LidarOptions { laser: Some(15), ..default() })
    );
}

#[test]
fn a_missing_beam_is_an_error_that_lists_the_beams() {
    let packets = packets_log(&around(160));
    assert_error(
        ingest(&packets, LidarOptions { ring: Some(32), ..default() }),
        &[
            "has no ring 32, it has rings 0 to 31 at -30.67, -29.33, ",
            ", 0.00, ",
            ", 10.67 deg; set one of `ingest.lidar.ring`",
        ],
    );
    let elevation_deg = Some(11.4);
    assert_error(
        ingest(&packets, LidarOptions { elevation_deg, ..default() }),
        &["has no beam at 11.4 deg"],
    );

    let clouds = cloud_log(&[revolution(&RINGS)]);
    let rings = "it has rings 0 at -10.00 deg, 1 at 0.00 deg, 2 at 10.00 deg;";
    for (requested, lidar) in [
        ("ring 3", LidarOptions { ring: Some(3), ..default() }),
        ("beam at 4.00 deg", LidarOptions { elevation_deg: Some(4.0), ..default() }),
        ("laser 15 (only packets have lasers)", LidarOptions { laser: Some(15), ..default() }),
    ] {
        let expected = format!("topic `/points` has no {requested}, {rings}");
        assert_error(ingest(&clouds, lidar), &[&expected]);
    }
    // Without a horizontal beam, the options must select one. The two middle beams of a VLP-16 are at
    // -1 and 1 deg.
    let slanted = cloud_log(&[revolution(&[-1.0, 1.0])]);
    assert_error(
        ingest(&slanted, default()),
        &["has no beam at 0.00 deg, it has rings 0 at -1.00 deg, 1 at 1.00 deg;"],
    );
    assert_eq!(
        ingest(&slanted, LidarOptions { ring: Some(1), ..default() }).unwrap().0[0].len(),
        360
    );
}

// Clouds -----------------------------------------------------------------------------------------

/// Elevations of the rings of a fictitious sensor \[deg\].
const RINGS: [f64; 3] = [-10.0, 0.0, 10.0];

/// x, y, z \[m\] and ring.
type Point = ([f32; 3], u16);

/// A revolution clockwise from straight ahead in steps of 1 deg, with all rings at each step. Ring k
/// measures a cylinder of radius 10 + k m.
fn revolution(elevations_deg: &[f64]) -> Vec<Point> {
    let of_step = |step: u32| {
        elevations_deg.iter().enumerate().map(move |(ring, elevation_deg)| {
            let radius_m = 10.0 + ring as f64;
            let (sin, cos) = f64::from(step).to_radians().sin_cos();
            let z = radius_m * elevation_deg.to_radians().tan();
            ([radius_m * cos, -radius_m * sin, z].map(|v| v as f32), ring as u16)
        })
    };
    (0..360).flat_map(of_step).collect()
}

const FIELDS: [(&str, Scalar); 4] =
    [("x", Scalar::F32), ("y", Scalar::F32), ("z", Scalar::F32), ("ring", Scalar::U16)];

/// A cloud of points with x, y, z, ring and time. `fields` gives the names. The times increase from
/// `first` by `span`.
fn cloud(
    stamp_ns: i64,
    points: &[Point],
    fields: &[(&str, Scalar)],
    (first, span): (f64, f64),
) -> Entry {
    let mut data = Vec::new();
    for (k, ([x, y, z], ring)) in points.iter().enumerate() {
        [x, y, z].iter().for_each(|v| data.extend(v.to_le_bytes()));
        data.extend(u32::from(*ring).to_le_bytes());
        data.extend((first + span * k as f64 / points.len() as f64).to_le_bytes());
    }
    let field = |(k, &(name, kind)): (usize, &(&str, Scalar))| PointField {
        name: name.to_owned(),
        offset: 4 * k,
        kind,
    };
    let cloud = PointCloud {
        stamp_ns,
        width: points.len(),
        height: 1,
        point_step: 24,
        row_step: 24 * points.len(),
        big_endian: false,
        fields: fields.iter().enumerate().map(field).collect(),
        data: Cow::Owned(data),
    };
    let data = ros::write_point_cloud2(Encoding::Cdr, "velodyne", &cloud);
    ("/points", "sensor_msgs/msg/PointCloud2", "cdr", data)
}

fn cloud_log(clouds: &[Vec<Point>]) -> Vec<Entry> {
    let stamps = (START_NS..).step_by(100_000_000);
    stamps.zip(clouds).map(|(stamp, points)| cloud(stamp, points, &FIELDS, (0.0, 0.0))).collect()
}

#[test]
fn a_cloud_gives_its_horizontal_ring() {
    let (found, ingested) = ingest(&cloud_log(&[revolution(&RINGS)]), default()).unwrap();
    assert_eq!((found.len(), ingested.notes.len(), ingested.losses.is_empty()), (1, 0, true));
    let scan = &found[0];
    assert_eq!((scan.len(), scan.stamp_ns, scan.hole_deg), (360, START_NS, 0.0));
    assert!(close(scan.coverage_deg, 359.0), "{}", scan.coverage_deg);
    assert!(close(scan.x_m[0], 11.0) && close(scan.y_m[90], -11.0));
    let slanted = LidarOptions { elevation_deg: Some(-9.5), ..default() };
    let (found, _) = ingest(&cloud_log(&[revolution(&RINGS)]), slanted).unwrap();
    assert!(close(found[0].x_m[0], 10.0), "the projection of the slanted range is x");
}

/// Drivers that split by number of packets make such clouds: from 40 deg on, and up to 60 deg of the
/// next revolution.
#[test]
fn a_cloud_of_more_than_one_revolution_gives_the_first() {
    let whole = revolution(&RINGS);
    let less = whole[40 * RINGS.len()..].to_vec();
    let more = [&whole[..], &whole[..61 * RINGS.len()]].concat();
    let twice = [&whole[..], &whole[..]].concat();
    let (found, ingested) = ingest(&cloud_log(&[less, more, twice]), default()).unwrap();
    assert_eq!(found.iter().map(Scan::len).collect::<Vec<_>>(), [320, 360, 360]);
    assert!(close(found[0].coverage_deg, 319.0) && !found[0].is_ring());
    assert!(close(found[1].coverage_deg, 359.0) && found[1].is_ring());
    assert_eq!(found[2].x_m, found[1].x_m);
    assert_eq!(codes(&ingested.losses), [("returns_beyond_revolution", 61 + 360)]);
    assert!(ingested.notes.is_empty());
}

#[test]
fn a_cloud_without_a_ring_field_is_counted_with_its_fields() {
    let bare = cloud(
        START_NS,
        &revolution(&RINGS),
        &[&FIELDS[..3], &[("intensity", Scalar::F32)]].concat(),
        (0.0, 0.0),
    );
    let expected = "1 point cloud without a field `ring` (fields: x, y, z, intensity)";
    let output = ingest(std::slice::from_ref(&bare), default());
    assert_error(output, &["`/points` gives no scan", expected]);
    let mut mixed = cloud_log(&[revolution(&RINGS)]);
    mixed.push(bare);
    let (found, ingested) = ingest(&mixed, default()).unwrap();
    assert_eq!((found.len(), codes(&ingested.losses)), (1, vec![("clouds_without_field", 1)]));
}

#[test]
fn unordered_points_are_sorted_and_noted() {
    let in_order = revolution(&RINGS);
    let mut shuffled = in_order.clone();
    let mut state = 2436u64;
    for k in (1..shuffled.len()).rev() {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        shuffled.swap(k, (state >> 33) as usize % (k + 1));
    }
    let (expected, _) = ingest(&cloud_log(std::slice::from_ref(&in_order)), default()).unwrap();
    let (found, ingested) = ingest(&cloud_log(&[in_order, shuffled]), default()).unwrap();
    assert_eq!(found[0], expected[0]);
    assert_eq!((&found[1].x_m, &found[1].y_m), (&expected[0].x_m, &expected[0].y_m));
    assert_eq!(kinds(&ingested), [&NoteKind::CloudsSorted { n_clouds: 1 }]);
    assert!(ingested.losses.is_empty());
}

#[test]
fn clouds_without_returns_at_the_start_do_not_hide_the_rings() {
    let mut clouds = vec![Vec::new(); 12];
    // Then the horizontal beam has no returns for some clouds.
    let slanted: Vec<Point> =
        revolution(&RINGS).into_iter().filter(|(_, ring)| *ring != 1).collect();
    clouds.extend(vec![slanted; 12]);
    clouds.push(revolution(&RINGS));
    let (found, _) = ingest(&cloud_log(&clouds), default()).unwrap();
    assert_eq!(found.iter().map(Scan::len).collect::<Vec<_>>(), [vec![0; 24], vec![360]].concat());
}

#[test]
fn point_times_from_another_clock_are_ignored() {
    const IGNORED: &str = "cloud_times_ignored";
    const UNUSUAL: &str = "point_time_unit";
    for (first, span, after_ns, expected) in [
        // 50 ms after the stamp, 50 ms after the stamp since the epoch, and the same in nanoseconds.
        (0.05, 0.1, 50_000_000, vec![UNUSUAL]),
        (1.44e9 + 0.05, 0.1, 50_000_000, vec![]),
        (1.44e18 + 5e7, 1e8, 50_000_000, vec![UNUSUAL]),
        // Of another day, and since the start of the sensor.
        (1.4e9, 0.1, 0, vec![IGNORED]),
        (5000.0, 0.1, 0, vec![IGNORED, UNUSUAL]),
    ] {
        let fields = [&FIELDS[..], &[("timestamp", Scalar::F64)]].concat();
        let log = [cloud(START_NS, &revolution(&RINGS), &fields, (first, span))];
        let (found, ingested) = ingest(&log, default()).unwrap();
        // The first point of the ring is the second of the cloud. An f64 has a resolution of 240 ns
        // for seconds since the epoch.
        let second_ns = if expected.contains(&IGNORED) { 0 } else { 100_000_000 / 1080 };
        let error_ns = found[0].stamp_ns - START_NS - after_ns - second_ns;
        assert!(error_ns.abs() <= 480, "{first}: {error_ns} ns");
        let mut codes: Vec<_> = kinds(&ingested).iter().map(|kind| kind.code()).collect();
        codes.sort_unstable();
        assert_eq!(codes, expected, "{first}");
    }
}

// Returns ----------------------------------------------------------------------------------------

/// Packets with two blocks per firing: `last` \[2 mm\] with intensity 50 and `strongest` with 90.
fn dual(n: usize, last: u16, strongest: u16, strongest_first: bool) -> Vec<Stamped> {
    let packet = |k: usize| {
        let azimuths = std::array::from_fn(|b| ((STEP * (6 * k + b / 2) as u32) % 36_000) as u16);
        let mut packet = PacketBuilder::new(azimuths, device_us(k) / 2);
        packet.set_return_mode(ReturnMode::Dual);
        for block in 0..BLOCKS {
            let (distance, intensity) = match (block % 2 == 0) == strongest_first {
                true => (strongest, 90),
                false => (last, 50),
            };
            packet.set_return(block, 15, distance, intensity);
        }
        (START_NS + (k as i64 + 1) * 276_480, packet.finish())
    };
    (0..n).map(packet).collect()
}

#[test]
fn dual_return_packets_give_the_stronger_return_in_either_order() {
    let (single, _) = scans(&stream(310, |_, laser| if laser == 15 { 700 } else { 0 }), default());
    for strongest_first in [false, true] {
        let (found, ingested) = scans(&dual(620, 900, 700, strongest_first), default());
        assert_eq!(found, single);
        assert!(ingested.losses.is_empty());
    }
}

#[test]
fn range_limits_are_inclusive_and_apply_to_the_slanted_range() {
    // 0.9 m and 70 m are 450 and 35,000 counts.
    let distances = [449, 450, 35_000, 35_001, 0];
    let packets = stream(310, |firing, _| distances[firing % 5]);
    let (found, _) = scans(&packets, default());
    let ranges =
        |scan: &Scan| scan.x_m.iter().zip(&scan.y_m).map(|(x, y)| x.hypot(*y)).collect::<Vec<_>>();
    let found = ranges(&found[0]);
    assert_eq!(found.len(), 720);
    assert!(found.chunks(2).all(|pair| close(pair[0], 0.9) && close(pair[1], 70.0)));
    // The limits apply to the slanted range: 69.5 m at -30.67 deg are 59.8 m in the plane.
    let slanted = LidarOptions { laser: Some(0), range_max_m: 69.0, range_min_m: 0.0, ..default() };
    let (found, _) = scans(&stream(310, |firing, _| [34_500, 34_501][firing % 2]), slanted.clone());
    assert_eq!(found[0].len(), 900, "69 m is kept, 69.002 m is not");
    // The same for clouds and planar scans, which use f32.
    let ahead: Vec<Point> =
        [0.899_999_9, 0.9, 70.0, 70.000_01].iter().map(|x| ([*x, 0.0, 0.0], 0)).collect();
    let (found, _) = ingest(&cloud_log(&[ahead]), default()).unwrap();
    assert_eq!(found[0].x_m, [0.9, 70.0]);
    let far = LidarOptions { range_min_m: 20.0, ..default() };
    let output = ingest(&cloud_log(&[revolution(&RINGS)]), far.clone());
    assert_error(output, &["none of the 360 points of the ring is within 20 to 70 m"]);
    let mut one_far = revolution(&RINGS);
    one_far[1].0 = [30.0, 0.0, 0.0];
    let (found, _) = ingest(&cloud_log(&[one_far]), far).unwrap();
    assert_eq!(found[0].len(), 1);
    assert!(close(found[0].coverage_deg, 359.0), "the coverage does not depend on the limits");
    let planar: Vec<Entry> = planar_log().into_iter().take(1).collect(); // 1, 2, ... 7 m
    let (found, _) =
        ingest(&planar, LidarOptions { range_min_m: 2.0, range_max_m: 5.0, ..default() }).unwrap();
    assert_eq!(
        ranges(&found[0]).iter().map(|r| r.round()).collect::<Vec<_>>(),
        [2.0, 3.0, 4.0, 5.0]
    );
}

#[test]
fn upside_down_mirrors_scans_of_every_kind() {
    let packets = packets_log(&stream(310, |firing, _| 1000 + (firing % 1800) as u16));
    let planar: Vec<Entry> = planar_log().into_iter().step_by(2).collect();
    for log in [packets, cloud_log(&[revolution(&RINGS)]), planar] {
        let (upright, _) = ingest(&log, default()).unwrap();
        let (hanging, _) = ingest(&log, LidarOptions { upside_down: true, ..default() }).unwrap();
        assert_eq!(upright.len(), hanging.len());
        for (a, b) in upright.iter().zip(&hanging) {
            assert!(a.y_m.iter().any(|y| 1.0 < y.abs()));
            assert!(a.y_m.iter().zip(&b.y_m).all(|(a, b)| *a == -b));
            assert_eq!((&a.x_m, a.stamp_ns, a.coverage_deg), (&b.x_m, b.stamp_ns, b.coverage_deg));
        }
    }
}

// Other sensors ----------------------------------------------------------------------------------

#[test]
fn other_velodyne_models_are_errors_that_name_the_model() {
    // A VLP-16 whose product byte says HDL-32E and whose clock stands still. Its stamps show a packet
    // every 1327 us.
    let mut vlp16 = around(300);
    for (k, packet) in vlp16.iter_mut().enumerate() {
        packet.0 = START_NS + k as i64 * 1_327_104;
        set_device_us(packet, 7);
    }
    let expected =
        "packets of a Velodyne VLP-16 (a packet every 1327 us), expected a Velodyne HDL-32E";
    assert_error(ingest(&packets_log(&vlp16), default()), &[expected]);
    // A VLP-32C, identified by the device clock: a packet every 663.552 us.
    let mut vlp32c = around(300);
    for (k, packet) in vlp32c.iter_mut().enumerate() {
        set_device_us(packet, (k * 663_552 / 1000) as u32);
        packet.0 = START_NS + k as i64 * 663_552;
    }
    assert_error(
        ingest(&packets_log(&vlp32c), default()),
        &["Velodyne VLP-32C (a packet every 664 us)"],
    );
    // If the device clock and the stamps stand still, only the product byte identifies the model.
    let mut byte_alone = around(300);
    for packet in &mut byte_alone {
        set_device_us(packet, 7);
        packet.0 = START_NS;
        packet.1[1205] = 0x22;
    }
    assert_error(
        ingest(&packets_log(&byte_alone), default()),
        &["Velodyne VLP-16 (product byte 0x22)"],
    );
    // The first two bytes of a block are a flag. 0xDDFF is the lower half of an HDL-64E. A VLS-128 has
    // four different flags.
    for (high_bytes, name) in
        [([0xEE, 0xDD, 0xEE, 0xDD], "HDL-64E"), ([0xEE, 0xDD, 0xCC, 0xBB], "VLS-128 (Alpha Prime)")]
    {
        let mut flagged = around(300);
        for (_, bytes) in &mut flagged {
            (0..BLOCKS).for_each(|block| bytes[100 * block + 1] = high_bytes[block % 4]);
        }
        let expected = format!("packets of a Velodyne {name} (by the flags of its blocks)");
        assert_error(ingest(&packets_log(&flagged), default()), &[&expected]);
    }
}

// Time -------------------------------------------------------------------------------------------

#[test]
fn the_device_clock_wraps_at_the_top_of_the_hour() {
    let plain = around(460);
    let mut across = plain.clone();
    for (k, packet) in across.iter_mut().enumerate() {
        let us = u64::from(HOUR_US) - 100_000 + u64::from(device_us(k));
        set_device_us(packet, (us % u64::from(HOUR_US)) as u32);
    }
    for clock in [Clock::Host, Clock::Device] {
        let lidar = || LidarOptions { clock, ..default() };
        assert_eq!(scans(&across, lidar()), scans(&plain, lidar()));
    }
}

/// Revolution n starts after 150 n packets of 552.96 us. Laser 15 fires 17.28 us into its block.
fn due_ns(revolution: usize) -> i64 {
    START_NS + (PACKETS_PER_REVOLUTION * revolution) as i64 * 552_960 + 17_280
}

#[test]
fn the_device_clock_removes_network_delays() {
    // Every tenth packet has no delay, the others up to 9 ms.
    let mut late = around(760);
    late.iter_mut()
        .enumerate()
        .for_each(|(k, packet)| packet.0 += 1_000_000 * ((k + 1) % 10) as i64);
    let errors = |clock| -> Vec<i64> {
        let (found, ingested) = scans(&late, LidarOptions { clock, ..default() });
        assert_eq!((found.len(), ingested.losses.is_empty()), (5, true));
        found.iter().enumerate().map(|(k, scan)| scan.stamp_ns - due_ns(k)).collect()
    };
    assert_eq!(errors(Clock::Host), [1_000_000; 5], "packets 0, 150, ... are 1 ms late");
    // The first revolution starts before the first packet without delay. The device counts whole
    // microseconds.
    let device = errors(Clock::Device);
    assert!(device[1..].iter().all(|error| error.abs() <= 1000), "{device:?}");
}

#[test]
fn on_gps_time_the_device_clock_gives_the_time() {
    let mut late = around(460);
    late.iter_mut().for_each(|packet| packet.0 += 200_000_000);
    let gps = || LidarOptions { clock: Clock::Gps, ..default() };
    let (found, _) = scans(&late, gps());
    for (k, scan) in found.iter().enumerate() {
        assert!((scan.stamp_ns - due_ns(k)).abs() <= 1000, "{}", scan.stamp_ns - due_ns(k));
    }
    let mut free_running = around(460);
    free_running.iter_mut().for_each(|packet| packet.0 += 600_000_000_000);
    assert_error(
        ingest(&packets_log(&free_running), gps()),
        &[
            "460 packets whose device clock is not on GPS time (more than 60 s from the stamps; set `ingest.lidar.clock` to \"host\" or \"device\")",
        ],
    );
}

// Losses -----------------------------------------------------------------------------------------

/// Three packets are 36 firings of 0.2 deg: 7.2 deg without packets. One packet is 2.4 deg, which is
/// below the limit of the note.
#[test]
fn missing_packets_are_measured_as_an_angle() {
    let mut holed = around(460);
    holed.drain(200..203);
    holed.remove(20);
    let (found, ingested) = scans(&holed, default());
    let holes: Vec<f32> = found.iter().map(|scan| scan.hole_deg).collect();
    assert!(close(holes[0], 2.4) && close(holes[1], 7.2) && holes[2] == 0.0, "{holes:?}");
    assert_eq!(found.iter().map(Scan::len).collect::<Vec<_>>(), [1788, 1764, 1800]);
    assert!(found.iter().all(Scan::is_ring), "a gap does not make a scan a partial circle");
    assert!(ingested.losses.is_empty());
    let note = NoteKind::MissingPackets { n_packets: 4, n_scans: 1, min_hole_deg: 5.0 };
    assert!(kinds(&ingested).contains(&&note), "{:?}", ingested.notes);
}

/// A quarter of 150 packets is 37.5.
#[test]
fn a_revolution_with_too_many_missing_packets_is_dropped_and_counted() {
    for (n_missing, max_missing_share, n_scans) in
        [(37, 0.25, 3), (38, 0.25, 2), (38, 0.5, 3), (1, 0.0, 2)]
    {
        let mut holed = around(460);
        holed.drain(200..200 + n_missing);
        let (found, ingested) = scans(&holed, LidarOptions { max_missing_share, ..default() });
        assert_eq!(found.len(), n_scans, "{n_missing} of {max_missing_share}");
        let expected = if n_scans == 3 { vec![] } else { vec![("incomplete_revolutions", 1)] };
        assert_eq!(codes(&ingested.losses), expected);
    }
}

// Split drives -----------------------------------------------------------------------------------

/// A recorder starts a new file in the middle of a revolution. The files can be given in any order.
#[test]
fn a_drive_in_several_files_gives_the_same_as_one_file() {
    let packets = packets_log(&around(760));
    let folder = tempfile::tempdir().unwrap();
    let write_part = |name: &str, range: std::ops::Range<usize>| {
        let path = folder.path().join(name);
        let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
        let schema = writer.add_schema(packets[0].1, "ros2msg", b"").unwrap();
        let channel_id =
            writer.add_channel(schema, "/packets", "cdr", &Default::default()).unwrap();
        for (k, (.., data)) in packets.iter().enumerate().take(range.end).skip(range.start) {
            let time = 1_000_000_000 + k as u64 * 22_118_400;
            let header = MessageHeader {
                channel_id,
                sequence: k as u32,
                log_time: time,
                publish_time: time,
            };
            writer.write_to_known_channel(&header, data).unwrap();
        }
        writer.finish().unwrap();
        std::fs::write(&path, writer.into_inner().into_inner()).unwrap();
        path
    };
    let options = options("/packets", None);
    let whole = ingest_files(&[write_part("whole.mcap", 0..packets.len())], &options).unwrap();
    assert_eq!((whole.0.len(), whole.1.n_partial_revolutions), (5, 1));
    let parts = [("a.mcap", 13..packets.len()), ("b.mcap", 0..6), ("c.mcap", 6..13)];
    let parts = parts.map(|(name, range)| write_part(name, range));
    assert_eq!(ingest_files(&parts, &options).unwrap(), whole);
    // Without the file with packets 240 to 519, revolution 0 (packets 0 to 149) and revolution 4 (600 to
    // 749) are complete, revolutions 1 and 3 are partial, and revolution 2 is missing.
    let (found, ingested) = ingest_files(&parts[..2], &options).unwrap();
    assert_eq!([&found[0], &found[1]], [&whole.0[0], &whole.0[4]]);
    assert_eq!(
        codes(&ingested.losses),
        [("missing_revolutions", 1), ("incomplete_revolutions", 2)]
    );
}
