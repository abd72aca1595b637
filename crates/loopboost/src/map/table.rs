//! A comparison of two runs for people, on stdout.

use evaluate::comparison::{
    ComparedClosures, ComparedTrajectory, Comparison, Presence, ReasonCount,
};

/// Prints all parts of a comparison.
pub(super) fn print(of: &Comparison) {
    for (side, run) in [("A", &of.a), ("B", &of.b)] {
        out!("{side}: {} (loopboost {}, seed {})", run.folder, run.program_version, run.seed);
    }
    if !of.origins.is_empty() {
        out!("\nmade from other files, or with other options:");
    }
    for origin in &of.origins {
        let text = |value: &Option<String>| value.clone().unwrap_or_else(|| "none".to_owned());
        out!("  {}: {}: {} -> {}", origin.table, origin.key, text(&origin.a), text(&origin.b));
    }
    logs(of);
    closures(&of.closures);
    trajectories(&of.trajectories);
    labels(of);
    out!("");
    match of.is_changed() {
        true => out!("changed beyond the tolerances: {}", of.changes.join(", ")),
        false => out!("nothing changed beyond the tolerances"),
    }
}

fn logs(of: &Comparison) {
    let header = ["log", "in", "keyframes A", "B", "both", "other stamps", "maps A", "B"];
    let rows = of.logs.iter().map(|log| {
        let presence = match log.presence {
            Presence::Both => "A, B",
            Presence::OnlyA => "A",
            Presence::OnlyB => "B",
        };
        let counts = [
            log.n_keyframes_a,
            log.n_keyframes_b,
            log.n_common_keyframes,
            log.n_other_stamps,
            log.n_maps_a,
            log.n_maps_b,
        ];
        let cells = [log.log.clone(), presence.to_owned()].into_iter();
        cells.chain(counts.map(|n| n.to_string())).collect()
    });
    print_table(&header, rows.collect());
    for (side, pairs) in [("A", &of.maps.joined_only_in_a), ("B", &of.maps.joined_only_in_b)] {
        for [first, second] in pairs {
            out!("`{first}` and `{second}` are in one map in {side} only");
        }
    }
}

fn closures(of: &ComparedClosures) {
    let counts = |name: &str, numbers: [usize; 5]| -> Vec<String> {
        [name.to_owned()].into_iter().chain(numbers.map(|n| n.to_string())).collect()
    };
    let kept_keyframes = of.n_closed_keyframes_a - of.n_closed_keyframes_only_a;
    let rows = vec![
        counts("accepted closures", [of.n_a, of.n_b, of.n_kept, of.n_lost, of.n_gained]),
        counts(
            "keyframes with a closure",
            [
                of.n_closed_keyframes_a,
                of.n_closed_keyframes_b,
                kept_keyframes,
                of.n_closed_keyframes_only_a,
                of.n_closed_keyframes_only_b,
            ],
        ),
    ];
    print_table(&["", "A", "B", "kept", "lost", "gained"], rows);
    let of_logs = [("A", of.n_with_logs_only_in_a), ("B", of.n_with_logs_only_in_b)];
    for (side, n) in of_logs.into_iter().filter(|(_, n)| 0 < *n) {
        out!("{n} closures of {side} are with logs that only {side} has");
    }
    let reasons = |counts: &[ReasonCount]| {
        counts.iter().map(|c| format!("{} {}", c.n, c.reason)).collect::<Vec<_>>().join(", ")
    };
    if !of.lost.is_empty() {
        out!("lost, by the reason in B: {}", reasons(&of.lost));
    }
    if !of.gained.is_empty() {
        out!("gained, by the reason in A: {}", reasons(&of.gained));
    }
    if let Some(kept) = &of.kept {
        let std = |value: Option<f64>| value.map_or("-".to_owned(), |std| format!("{std:.2}"));
        let row = |name: &str, m: f64, deg: f64, of_std: Option<f64>| {
            vec![name.to_owned(), format!("{m:.4} m"), format!("{deg:.3} deg"), std(of_std)]
        };
        let rows = vec![
            row("median", kept.median_m, kept.median_deg, kept.median_std),
            row("largest", kept.max_m, kept.max_deg, kept.max_std),
        ];
        print_table(&["motion of kept closures", "shift", "turn", "std"], rows);
        out!("{} of {} moved by more than the tolerance", of.n_moved, of.n_kept);
    }
}

fn trajectories(of: &[ComparedTrajectory]) {
    let header =
        ["trajectory", "maps", "scans", "median", "largest", "median", "largest", "largest near"];
    let rows = of.iter().map(|of| {
        vec![
            of.logs.join(" + "),
            format!("{}, {}", of.map_a, of.map_b),
            of.n_scans.to_string(),
            format!("{:.4} m", of.median_m),
            format!("{:.4} m", of.max_m),
            format!("{:.3} deg", of.median_deg),
            format!("{:.3} deg", of.max_deg),
            format!("scan {}, {:.0} m", of.farthest.keyframe, of.farthest.travel_m),
        ]
    });
    print_table(&header, rows.collect());
}

fn labels(of: &Comparison) {
    let row = |name: String, numbers: [usize; 3], more: [usize; 2]| -> Vec<String> {
        let numbers = numbers.into_iter().chain(more).map(|n| n.to_string());
        [name].into_iter().chain(numbers).collect()
    };
    let mut rows = Vec::new();
    if let Some(labels) = &of.labels {
        let flips = [labels.n_positive_to_negative, labels.n_negative_to_positive];
        rows.push(row(
            "labelled pairs".to_owned(),
            [labels.n_a, labels.n_b, labels.n_common],
            flips,
        ));
    }
    let places = &of.places;
    let radius_m = of.place_rule.positive_radius_m;
    rows.push(row(
        format!("keyframe pairs within {radius_m} m"),
        [places.n_a, places.n_b, places.n_a - places.n_only_a],
        [places.n_only_a, places.n_only_b],
    ));
    print_table(&["", "A", "B", "both", "no longer", "newly"], rows);
}

/// Prints an empty line and a table. The first column is aligned to the left, the others to the right.
fn print_table(header: &[&str], rows: Vec<Vec<String>>) {
    let header: Vec<String> = header.iter().map(|&cell| cell.to_owned()).collect();
    let rows: Vec<Vec<String>> = [header].into_iter().chain(rows).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max();
    let widths: Vec<usize> = (0..rows[0].len()).filter_map(width).collect();
    out!("");
    for row in &rows {
        let cells = row.iter().zip(&widths).enumerate().map(|(k, (cell, width))| match k {
            0 => format!("{cell:<width$}"),
            _ => format!("{cell:>width$}"),
        });
        out!("{}", cells.collect::<Vec<_>>().join("  ").trim_end());
    }
}
