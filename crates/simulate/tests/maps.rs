//! Drives on a map on different days.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

use std::path::Path;

use dataset::Pose2;
use simulate::{Campus, Map, Options, Point, Surface, write_drive};

/// A map of 24 m x 16 m at 0.1 m per pixel: a corridor 2.4 m wide along the middle, with two rooms on
/// each side. Doors are 1.2 m wide and walls 0.2 m thick.
fn map(folder: &Path) -> Map {
    let (n_x, n_y) = (240, 160);
    let is_wall = |i: i32, j: i32| {
        let is_outer = i < 2 || j < 2 || 238 <= i || 158 <= j;
        let is_between_rooms = (119..121).contains(&i) && !(66..94).contains(&j);
        let is_at_corridor = (66..68).contains(&j) || (92..94).contains(&j);
        let is_door = (50..62).contains(&i) || (180..192).contains(&i);
        is_outer || is_between_rooms || (is_at_corridor && !is_door)
    };
    let pixels = (0..n_y).flat_map(|j| (0..n_x).map(move |i| if is_wall(i, j) { 0 } else { 254 }));
    let image = [format!("P5\n{n_x} {n_y}\n255\n").into_bytes(), pixels.collect()].concat();
    std::fs::write(folder.join("map.pgm"), image).unwrap();
    let text = "image: map.pgm\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n\
                occupied_thresh: 0.65\nfree_thresh: 0.196\n";
    std::fs::write(folder.join("map.yaml"), text).unwrap();
    Map::load(&folder.join("map.yaml")).unwrap()
}

fn campus(seed: u64, length_m: f64, n_logs: usize) -> Campus {
    let folder = tempfile::tempdir().unwrap();
    let logs = (0..n_logs).map(|k| format!("day-{k}")).collect();
    let options =
        Options { logs, length_m, map: Some("map.yaml".to_owned()), ..Options::default() };
    Campus::on_map(&options, seed, map(folder.path())).unwrap()
}

/// The surfaces of log `a` that log `b` does not have.
fn only(campus: &Campus, a: usize, b: usize) -> Vec<Surface> {
    let of_b = campus.drive(b).surfaces();
    campus.drive(a).surfaces().iter().filter(|surface| !of_b.contains(surface)).copied().collect()
}

#[test]
fn furniture_moves_and_doors_open_and_close_from_day_to_day() {
    let campus = campus(5, 60.0, 6);
    // The four doors are in the middle of the first row of pixels of their walls.
    let is_door = |s: &Surface| {
        let (a, b) = (s.segment.start, s.segment.end);
        (a.y - b.y).abs() < 1e-9 && ((b.x - a.x).abs() - 1.2).abs() < 1e-9 && s.z_high_m == 2.7
    };
    let mut closed_doors = Vec::new();
    for log in 0..6 {
        let surfaces = campus.drive(log).surfaces();
        let n_furniture = surfaces.iter().filter(|s| s.z_high_m < 2.0).count();
        assert!(16 <= n_furniture, "{n_furniture} sides of furniture in log {log}");
        let doors = surfaces.iter().filter(|s| is_door(s));
        closed_doors.push(
            doors.map(|s| (s.segment.start.x.round(), s.segment.start.y)).collect::<Vec<_>>(),
        );
    }
    assert!(closed_doors.iter().any(|of_day| !of_day.is_empty()), "all doors are always open");
    assert!(
        closed_doors.iter().any(|of_day| *of_day != closed_doors[0]),
        "the same doors are closed every day"
    );
    for &(x, y) in closed_doors.iter().flatten() {
        assert!([5.0, 18.0].contains(&x) && ((y - 6.65).abs() < 1e-9 || (y - 9.25).abs() < 1e-9));
    }
    // Walls do not change.
    let changed = only(&campus, 0, 1);
    assert!(!changed.is_empty() && changed.iter().all(|s| s.z_high_m < 2.0 || is_door(s)));
    for log in 0..6 {
        let drive = campus.drive(log);
        for k in 0..3000 {
            let Pose2 { x_m, y_m, .. } = drive.pose_at(drive.start_ns() + k * 10_000_000);
            let at = Point::new(x_m, y_m);
            // The distance to walls is tested in `logs.rs`.
            let movables = drive.surfaces().iter().filter(|s| s.z_high_m < 2.0 || is_door(s));
            let clear_m = movables.map(|s| s.segment.distance_m(at));
            let clear_m = clear_m.fold(f64::MAX, f64::min);
            assert!(0.4 < clear_m, "log {log}: {clear_m} m at {at}");
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let bytes = |seed: u64, log: usize, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut out = std::io::Cursor::new(Vec::new());
            write_drive(&campus(seed, 12.0, 2), log, 0, &mut out).unwrap();
            out.into_inner()
        })
    };
    let one = bytes(5, 1, 1);
    assert!(one == bytes(5, 1, 2) && one == bytes(5, 1, 5), "threads differ");
    assert!(one != bytes(6, 1, 2), "seeds 5 and 6 do not differ");
    assert!(one != bytes(5, 0, 2), "logs 0 and 1 do not differ");
}
