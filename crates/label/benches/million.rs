//! Labels a million keyframes, next to a bare pass over their close pairs.
//!
//! `cargo bench -p label --bench million`, or `-- N WORLD` for N keyframes and one of the worlds.
//!
//! Three worlds: many drives over the roads of a campus, one long line, and a hall that is covered
//! evenly. The limit is what no program can do without: one pass over the pairs within
//! `positive_radius_m`, in a plain grid with cells of this width. It only counts them: no rules, no negatives,
//! no draw.
//!
//! CPU time and memory come from `/proc` of Linux. The memory is the largest one of the whole benchmark up to
//! each line, with the keyframes.

#![allow(clippy::print_stdout, reason = "a benchmark prints its results")]

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Instant;

use dataset::{Keyframe, Pose2, ScanId, SplitMix64};
use rayon::prelude::*;

const N: usize = 1_000_000;
const SPACING_M: f64 = 0.5;
const SEED: u64 = 2436;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let n = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(N);
    let worlds = [("line", line as World), ("campus", campus), ("hall", hall)];
    let is_named = |name: &str| arguments.iter().any(|argument| argument == name);
    let is_any_named = worlds.iter().any(|(name, _)| is_named(name));
    println!("{n} keyframes, {} threads", rayon::current_num_threads());
    for (name, world) in worlds.into_iter().filter(|(name, _)| !is_any_named || is_named(name)) {
        let keyframes = world(n);
        println!("{name}: {} MB of memory with its keyframes", peak_mb());
        let options = label::Options::default();
        let (label::Labelled { candidates, .. }, time) =
            timed(|| label::label(&options, SEED, &keyframes).expect("enough pairs"));
        let label::Candidates { positive, negative, ambiguous, .. } = candidates;
        println!("  {positive} positive, {negative} negative, {ambiguous} ambiguous");
        println!("  label      {time}, {} MB", peak_mb());
        let (n_close, time) = timed(|| bare_pass(&keyframes, options.positive_radius_m));
        assert_eq!(n_close, positive, "all close pairs are positive in these worlds");
        println!("  bare pass  {time}");
    }
}

/// The result and the time of some work.
fn timed<T>(work: impl FnOnce() -> T) -> (T, String) {
    let (start, cpu_secs) = (Instant::now(), cpu_secs());
    let result = work();
    let secs = start.elapsed().as_secs_f64();
    (result, format!("{secs:>6.2} s, {:>6.2} s of CPU time", self::cpu_secs() - cpu_secs))
}

type World = fn(usize) -> Vec<Keyframe>;

/// One log along a line that bends slowly, 0.5 m per keyframe.
fn line(n: usize) -> Vec<Keyframe> {
    let mut at = Pose2::default();
    let mut random = SplitMix64::new(1);
    let log: Arc<str> = "line".into();
    (0..n)
        .map(|k| {
            // Between 30 deg to both sides of the x axis, so that the line does not meet itself.
            at.heading_rad = (at.heading_rad + 0.02 * (random.unit() - 0.5)).clamp(-0.5, 0.5);
            at.x_m += SPACING_M * at.heading_rad.cos();
            at.y_m += SPACING_M * at.heading_rad.sin();
            keyframe(&log, k, at)
        })
        .collect()
}

/// Drives of 5000 keyframes over the roads of a campus: 6 by 6 roads, 100 m apart. At each crossing, a
/// drive continues in any direction but back. It keeps to its side of the road to about half a metre.
fn campus(n: usize) -> Vec<Keyframe> {
    const OF_DRIVE: usize = 5000;
    const ROADS: i32 = 6;
    const BLOCK_M: f64 = 100.0;
    let mut random = SplitMix64::new(2);
    let mut keyframes = Vec::with_capacity(n);
    for drive in 0..n.div_ceil(OF_DRIVE) {
        let log: Arc<str> = format!("drive-{drive:04}").into();
        let (mut crossing, mut direction, mut along_m) = ([2, 2], random.below(4), 0.0);
        let side_m = 1.0 + 0.5 * (random.unit() - 0.5);
        for k in 0..OF_DRIVE.min(n - drive * OF_DRIVE) {
            let heading_rad = TAU / 4.0 * direction as f64;
            let (sin, cos) = heading_rad.sin_cos();
            let off_m = side_m + 0.3 * (random.unit() - 0.5);
            let [x, y] = crossing.map(|road| BLOCK_M * f64::from(road));
            let (x_m, y_m) = (x + along_m * cos + off_m * sin, y + along_m * sin - off_m * cos);
            keyframes.push(keyframe(&log, k, Pose2 { x_m, y_m, heading_rad }));
            along_m += SPACING_M;
            if BLOCK_M <= along_m {
                along_m = 0.0;
                let step = |direction: usize| [[1, 0], [0, 1], [-1, 0], [0, -1]][direction];
                let next = |at: [i32; 2], [dx, dy]: [i32; 2]| [at[0] + dx, at[1] + dy];
                crossing = next(crossing, step(direction));
                let back = (direction + 2) % 4;
                loop {
                    direction = random.below(4);
                    let is_road =
                        next(crossing, step(direction)).iter().all(|k| (0..ROADS).contains(k));
                    if is_road && direction != back {
                        break;
                    }
                }
            }
        }
    }
    keyframes
}

/// Drives that cover a hall 200 m wide evenly.
fn hall(n: usize) -> Vec<Keyframe> {
    let mut random = SplitMix64::new(3);
    let logs: Vec<Arc<str>> = (0..100).map(|log| format!("drive-{log}").into()).collect();
    (0..n)
        .map(|k| {
            let [x_m, y_m] = [(); 2].map(|()| 200.0 * random.unit());
            keyframe(&logs[k % 100], k / 100, Pose2 { x_m, y_m, heading_rad: 0.0 })
        })
        .collect()
}

fn keyframe(log: &Arc<str>, scan: usize, pose: Pose2) -> Keyframe {
    Keyframe {
        id: ScanId { log: log.clone(), scan: scan as u32 },
        site: "site".into(),
        stamp_ns: scan as i64 * 500_000_000,
        pose,
        covariance: None,
        z_m: None,
        segment: 0,
        frame: 0,
        map: None,
        travel_m: SPACING_M * scan as f64,
        coverage_deg: 360.0,
    }
}

/// The number of pairs within a radius.
fn bare_pass(keyframes: &[Keyframe], radius_m: f64) -> u64 {
    let cell = |pose: &Pose2| [pose.x_m, pose.y_m].map(|metres| (metres / radius_m).floor() as i64);
    let mut points: Vec<([i64; 2], [f64; 2])> =
        keyframes.iter().map(|k| (cell(&k.pose), [k.pose.x_m, k.pose.y_m])).collect();
    points.par_sort_unstable_by_key(|(cell, _)| *cell);
    let in_rows = |[x, low_y]: [i64; 2]| {
        let from = points.partition_point(|(cell, _)| *cell < [x, low_y]);
        let to = points.partition_point(|(cell, _)| *cell < [x, low_y + 3]);
        from..to
    };
    let cells: Vec<&[([i64; 2], [f64; 2])]> = points.chunk_by(|a, b| a.0 == b.0).collect();
    let of_cell = |of_cell: &&[([i64; 2], [f64; 2])]| {
        let [x, y] = of_cell[0].0;
        let mut n = 0u64;
        for x in x - 1..=x + 1 {
            for (_, b) in &points[in_rows([x, y - 1])] {
                for (_, a) in *of_cell {
                    let (dx, dy) = (a[0] - b[0], a[1] - b[1]);
                    n += u64::from((dx * dx + dy * dy).sqrt() <= radius_m);
                }
            }
        }
        n
    };
    let both_ways: u64 = cells.par_iter().map(of_cell).sum();
    (both_ways - keyframes.len() as u64) / 2
}

/// The largest memory of this process so far \[MB\]; 0 where it is not known.
fn peak_mb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|line| line.trim().trim_end_matches("kB").trim().parse().ok());
    kilobytes.map_or(0, |kilobytes: u64| kilobytes / 1000)
}

/// CPU time of all threads of this process \[s\]; 0 where it is not known. It has a resolution of 10 ms:
/// `proc(5)` states `utime` and `stime`, the 14th and 15th field, in clock ticks, of which there are 100 per
/// second on Linux.
fn cpu_secs() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The second field is the name of the program, in parentheses.
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks =
        after_name.split_whitespace().skip(11).take(2).filter_map(|n| n.parse::<f64>().ok());
    ticks.sum::<f64>() / 100.0
}
