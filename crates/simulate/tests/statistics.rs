//! Compares simulated scans with real ones: `hdl32e-street`, 2.5 revolutions of an HDL-32E in a street.
//! docs/simulation.md lists the numbers.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may panic and prints its results"
)]

#[path = "../../../tests/require.rs"]
mod require;

use std::fs;
use std::io::Cursor;

use messages::hdl32e::{BLOCKS, HORIZONTAL_LASER, HOUR_US, LASERS, METRES_PER_COUNT, Packet};
use messages::{Source, read_velodyne};
use simulate::{Campus, Lasers, Options, PACKETS_TOPIC, write_drive};

#[derive(Debug, Default)]
struct Statistics {
    /// Fraction of the firings of laser 15 that return.
    returns: f64,
    /// Mean of the same fraction over all lasers with returns.
    all_returns: f64,
    /// Lower quartile and median of the deviation from a straight wall in windows of 15 returns \[m\].
    noise_m: (f64, f64),
    /// Lower quartile and median of the distance between neighbouring returns, divided by the range.
    spacing: (f64, f64),
    /// Fractions of azimuth steps that are one count below the median, equal to it, and one above.
    steps: [f64; 3],
    /// Median azimuth step \[0.01 deg\].
    step: u16,
    /// Mean packet period by the clocks of the host and of the device \[us\].
    period_us: (f64, f64),
}

fn statistics(log: &[u8]) -> Statistics {
    let (mut stamps, mut clock, mut firings) = (Vec::new(), Vec::new(), Vec::new());
    let mut returns_by_laser = [0u64; LASERS];
    for message in mcap::MessageStream::new(log).unwrap() {
        let message = message.unwrap();
        if message.channel.topic != PACKETS_TOPIC {
            continue;
        }
        let schema = message.channel.schema.as_ref().unwrap();
        let source = Source::new(&schema.name, &message.channel.message_encoding).unwrap();
        for (stamp_ns, bytes) in read_velodyne(source, &message.data).unwrap().packets() {
            let packet = Packet::new(bytes).unwrap();
            stamps.push(stamp_ns);
            clock.push(packet.device_time_us());
            for block in 0..BLOCKS {
                let range_m =
                    f64::from(packet.distance(block, HORIZONTAL_LASER)) * METRES_PER_COUNT;
                firings.push((packet.azimuth(block), range_m));
                for (laser, n) in returns_by_laser.iter_mut().enumerate() {
                    *n += u64::from(0 < packet.distance(block, laser));
                }
            }
        }
    }
    let n = firings.len() as f64;
    let quantiles = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        (values[values.len() / 4], values[values.len() / 2])
    };
    let steps: Vec<u16> = (firings.windows(2))
        .map(|pair| ((36_000 + u32::from(pair[1].0) - u32::from(pair[0].0)) % 36_000) as u16)
        .collect();
    let step = quantiles(steps.iter().map(|&step| f64::from(step)).collect()).1 as u16;
    let share_of = |wanted: u16| {
        steps.iter().filter(|&&step| step == wanted).count() as f64 / steps.len() as f64
    };
    let point = |&(azimuth, range_m): &(u16, f64)| {
        let (sin, cos) = (f64::from(azimuth) * 0.01).to_radians().sin_cos();
        (range_m * cos, range_m * sin)
    };
    let spacing = |pair: &[(u16, f64)]| {
        let ((ax, ay), (bx, by)) = (point(&pair[0]), point(&pair[1]));
        let both = 0.0 < pair[0].1 && 0.0 < pair[1].1;
        both.then(|| (ax - bx).hypot(ay - by) / pair[0].1)
    };
    let alive: Vec<f64> =
        returns_by_laser.iter().filter(|n| 0 < **n).map(|&returns| returns as f64 / n).collect();
    let mean_us = |span: i64| span as f64 / (stamps.len() - 1) as f64;
    // The device clock may wrap at the top of the hour.
    let device_us = i64::from(clock[clock.len() - 1]) - i64::from(clock[0]);
    Statistics {
        returns: returns_by_laser[HORIZONTAL_LASER] as f64 / n,
        all_returns: alive.iter().sum::<f64>() / alive.len() as f64,
        noise_m: quantiles(firings.windows(15).filter_map(off_a_wall_m).collect()),
        spacing: quantiles(firings.windows(2).filter_map(spacing).collect()),
        steps: [share_of(step - 1), share_of(step), share_of(step + 1)],
        step,
        period_us: (
            mean_us((stamps[stamps.len() - 1] - stamps[0]) / 1000),
            mean_us(device_us.rem_euclid(i64::from(HOUR_US))),
        ),
    }
}

/// Deviation of the ranges from a straight wall, 1/r = a cos t + b sin t, fitted by least squares.
fn off_a_wall_m(window: &[(u16, f64)]) -> Option<f64> {
    if window.iter().any(|(_, range_m)| *range_m <= 0.0) {
        return None;
    }
    let (mut cc, mut cs, mut ss, mut cr, mut sr) = (0.0, 0.0, 0.0, 0.0, 0.0);
    // Angles relative to the middle of the window keep rounding errors small.
    let middle = window[window.len() / 2].0;
    let angle = |azimuth: u16| (f64::from(azimuth) - f64::from(middle)).to_radians() * 0.01;
    for &(azimuth, range_m) in window {
        let (sin, cos) = angle(azimuth).sin_cos();
        cc += cos * cos;
        cs += cos * sin;
        ss += sin * sin;
        cr += cos / range_m;
        sr += sin / range_m;
    }
    let determinant = cc * ss - cs * cs;
    let (a, b) = ((cr * ss - sr * cs) / determinant, (sr * cc - cr * cs) / determinant);
    let off = |&(azimuth, range_m): &(u16, f64)| {
        let (sin, cos) = angle(azimuth).sin_cos();
        range_m - 1.0 / (a * cos + b * sin)
    };
    let squares: f64 = window.iter().map(|firing| off(firing).powi(2)).sum();
    Some((squares / (window.len() - 2) as f64).sqrt())
}

/// A drive outdoors between buildings, at the 9.06 revolutions per second of the real log. The
/// fraction of returns depends on the street, so its tolerance is larger than that of the values that
/// depend on the sensor only.
#[test]
fn simulated_scans_have_the_statistics_of_real_ones() {
    const STREET: &str = "logs/hdl32e-street.ros2.mcap";
    let Some(data) = require::shared_data(&[STREET]) else { return };
    let street = fs::read(data.join(STREET)).unwrap();
    let options = Options {
        buildings: 7,
        lasers: Lasers::All,
        spin_hz: 9.06,
        length_m: 26.0,
        ..Options::default()
    };
    let mut out = Cursor::new(Vec::new());
    write_drive(&Campus::new(&options, 2436).unwrap(), 0, 0, &mut out).unwrap();
    let (real, made) = (statistics(&street), statistics(&out.into_inner()));
    println!("real {real:#?}\nsimulated {made:#?}");
    let close = |made: f64, real: f64, by: f64| {
        assert!((made - real).abs() <= by, "{made} simulated, {real} real");
    };
    let alike = |made: f64, real: f64| {
        assert!((0.7..1.4).contains(&(made / real)), "{made} simulated, {real} real");
    };
    close(made.returns, real.returns, 0.25);
    close(made.all_returns, real.all_returns, 0.1);
    alike(made.noise_m.0, real.noise_m.0);
    alike(made.noise_m.1, real.noise_m.1);
    alike(made.spacing.0, real.spacing.0);
    alike(made.spacing.1, real.spacing.1);
    assert_eq!(made.step, real.step);
    for (made, real) in made.steps.into_iter().zip(real.steps) {
        close(made, real, 0.05);
    }
    close(made.period_us.0, real.period_us.0, 0.05);
    close(made.period_us.1, real.period_us.1, 0.05);
}
