//! All figures of a report.

use dataset::{Label, Pose2};

use crate::figures::{
    Axis, Chart, Cut, Figure, Heat, Scatter, Series, map, path, scan_pair, ticks,
};
use crate::report::{PAPER_ERROR_BELOW, PAPER_ROUNDS, distinct, name_of, percent};
use crate::sketches::{Kind, Sketches};
use crate::{ErrorRow, Evaluation, Input};

/// Draws all figures.
pub fn figures(input: &Input<'_>, evaluation: &Evaluation, sketches: &Sketches) -> Vec<Figure> {
    let mut figures = Vec::new();
    for grouping in evaluation.groupings() {
        let charts = [
            error_chart(input, evaluation, grouping),
            precision_recall_chart(input, evaluation, grouping),
        ];
        figures.extend(charts.map(|chart| Figure::new(&chart.id, chart.svg())));
    }
    if let Some(chart) = retrieval_chart(input) {
        figures.push(Figure::new(&chart.id, chart.svg()));
    }
    figures.extend(heats(input).into_iter().map(|heat| Figure::new(&heat.id, heat.svg())));
    if let Some(scatter) = scatter(input) {
        figures.push(Figure::new(&scatter.id, scatter.svg()));
    }
    figures.extend(scan_pairs(input, sketches));
    for (k, site) in distinct(input.keyframes.iter().map(|k| &*k.site)).into_iter().enumerate() {
        let id = format!("map-{}", k + 1);
        figures.push(Figure::new(&id, map(&id, site, input.keyframes, input.pairs)));
        if let Some(ground) = sketches.grounds.get(site) {
            let id = format!("ground-{}", k + 1);
            figures.push(Figure::new(&id, ground.svg(&id, site, &paths(input, site))));
        }
    }
    for (k, of_log) in input.keyframes.chunk_by(|a, b| a.id.log == b.id.log).enumerate() {
        let id = format!("path-{}", k + 1);
        figures.push(Figure::new(&id, path(&id, of_log)));
    }
    figures
}

/// The place of a learner among all, which gives it its style.
fn style_of(input: &Input<'_>, learner: &str) -> usize {
    let learners = distinct(input.scores.iter().map(|s| &*s.learner));
    learners.iter().position(|name| *name == learner).unwrap_or(0)
}

/// The keyframes' poses of each log of a site.
fn paths(input: &Input<'_>, site: &str) -> Vec<Vec<Pose2>> {
    let here: Vec<_> = input.keyframes.iter().filter(|k| &*k.site == site).collect();
    here.chunk_by(|a, b| a.id.log == b.id.log)
        .map(|log| log.iter().map(|k| k.pose).collect())
        .collect()
}

fn error_chart(input: &Input<'_>, evaluation: &Evaluation, grouping: &str) -> Chart {
    let rows: Vec<&ErrorRow> =
        evaluation.errors.iter().filter(|r| r.grouping == grouping).collect();
    let n_rounds = rows.iter().map(|r| r.rounds).max().unwrap_or(1);
    let highest = rows.iter().map(|r| r.confusion.error()).fold(0.05, f64::max);
    let step = match highest {
        h if h <= 0.1 => 0.02,
        h if h <= 0.3 => 0.05,
        _ => 0.1,
    };
    let top = (highest / step).ceil() * step;
    let x_step = (n_rounds / 5).max(1);
    let mut x_ticks: Vec<f64> = vec![1.0];
    x_ticks.extend((1..=n_rounds / x_step).map(|k| (k * x_step) as f64).filter(|&t| t > 1.0));
    let series = distinct(rows.iter().map(|r| &*r.learner))
        .into_iter()
        .map(|learner| {
            let of: Vec<_> = rows.iter().filter(|r| r.learner == learner).collect();
            // A baseline is a line across; one mark says its value.
            let every = if input.is_boosted(learner) { 1 } else { of.len().max(1) };
            let mark = |r: &&&ErrorRow| {
                let error = r.confusion.error();
                let text =
                    format!("{}, T = {}: error {}", name_of(learner), r.rounds, percent(error));
                (r.rounds as f64, error, text)
            };
            let mut points: Vec<_> =
                of.iter().map(|r| (r.rounds as f64, r.confusion.error())).collect();
            if let (false, Some(last)) = (input.is_boosted(learner), of.last()) {
                points.push((n_rounds as f64, last.confusion.error()));
            }
            Series {
                name: name_of(learner),
                style: style_of(input, learner),
                points,
                marks: of.iter().skip(every - 1).step_by(every).map(mark).collect(),
            }
        })
        .collect();
    // The paper dealt pairs at random.
    let is_papers = grouping == "pair" && PAPER_ROUNDS as usize <= n_rounds;
    Chart {
        below: is_papers.then(|| {
            let text = format!(
                "the paper: under {:.0} % at T = {PAPER_ROUNDS}",
                PAPER_ERROR_BELOW * 100.0
            );
            (f64::from(PAPER_ROUNDS), PAPER_ERROR_BELOW, text)
        }),
        id: format!("error-curve-{grouping}"),
        description: format!("Error against rounds, grouping {grouping}"),
        x: Axis {
            title: "rounds T".to_owned(),
            min: 1.0,
            max: (n_rounds as f64).max(2.0),
            ticks: x_ticks,
            format: |t| format!("{t:.0}"),
        },
        y: Axis {
            title: "error [%]".to_owned(),
            min: 0.0,
            max: top,
            ticks: (0..=(top / step).round() as usize).map(|k| k as f64 * step).collect(),
            format: |t| format!("{:.0}", t * 100.0),
        },
        series,
    }
}

fn recall_axis() -> Axis {
    Axis {
        title: "recall".to_owned(),
        min: 0.0,
        max: 1.0,
        ticks: (0..=5).map(|k| f64::from(k) / 5.0).collect(),
        format: |t| format!("{t:.1}"),
    }
}

fn precision_axis(min: f64) -> Axis {
    Axis {
        title: "precision".to_owned(),
        min,
        max: 1.0,
        ticks: ticks(min, 1.0),
        format: |t| format!("{t:.1}"),
    }
}

/// Points of a curve of (recall, precision), and a mark at each tenth of recall.
fn curve(input: &Input<'_>, learner: &str, points: Vec<(f64, f64)>) -> Series {
    let name = name_of(learner);
    let mut marks = Vec::new();
    for &(recall, precision) in &points {
        if (marks.len() + 1) as f64 / 10.0 <= recall {
            let text =
                format!("{name}: precision {} at recall {}", percent(precision), percent(recall));
            marks.push((recall, precision, text));
        }
    }
    Series { name, style: style_of(input, learner), points, marks }
}

fn precision_recall_chart(input: &Input<'_>, evaluation: &Evaluation, grouping: &str) -> Chart {
    let series = evaluation
        .precision_recall
        .iter()
        .filter(|curve| curve.grouping == grouping)
        .map(|c| {
            let point =
                |p: &crate::PrPoint| (p.confusion.recall(), p.confusion.precision().unwrap_or(1.0));
            curve(input, &c.learner, c.points.iter().map(point).collect())
        })
        .collect();
    Chart {
        below: None,
        id: format!("precision-recall-{grouping}"),
        description: format!("Precision against recall, grouping {grouping}"),
        x: recall_axis(),
        // Balanced pairs have a precision of at least about one half.
        y: precision_axis(0.4),
        series,
    }
}

/// All logs together, the ambiguous pairs left out.
fn retrieval_chart(input: &Input<'_>) -> Option<Chart> {
    let series: Vec<Series> = input
        .retrieval_of_all()
        .filter(|r| !r.ambiguous_as_negative)
        .map(|r| {
            let point = |p: &dataset::RetrievalPoint| {
                let called = (p.true_positive + p.false_positive) as f64;
                (p.true_positive as f64 / r.n_positive as f64, p.true_positive as f64 / called)
            };
            curve(input, &r.learner, r.curve.iter().map(point).collect())
        })
        .collect();
    (!series.is_empty()).then(|| Chart {
        below: None,
        id: "every-pair".to_owned(),
        description: "Precision against recall among all pairs of keyframes".to_owned(),
        x: recall_axis(),
        y: precision_axis(0.0),
        series,
    })
}

/// A table of errors for each learner and travel gap of the grid.
fn heats(input: &Input<'_>) -> Vec<Heat> {
    let values = |of: fn(&dataset::GridCell) -> f64| {
        let mut values: Vec<f64> = input.grid.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values.dedup_by(|a, b| a.total_cmp(b).is_eq());
        values
    };
    let highest =
        input.grid.iter().filter_map(|c| c.error.as_ref().ok()).fold(0.01, |a, &b| b.max(a));
    let (columns, rows) = (values(|c| c.positive_radius_m), values(|c| c.negative_min_m));
    let mut heats = Vec::new();
    for learner in distinct(input.grid.iter().map(|c| &*c.learner)) {
        for gap in values(|c| c.min_travel_gap_m) {
            let cell = |row: f64, column: f64| {
                let found = input.grid.iter().find(|c| {
                    c.learner == learner
                        && c.min_travel_gap_m.total_cmp(&gap).is_eq()
                        && c.negative_min_m.total_cmp(&row).is_eq()
                        && c.positive_radius_m.total_cmp(&column).is_eq()
                });
                found.map_or_else(|| Err("not asked for".to_owned()), |c| c.error.clone())
            };
            heats.push(Heat {
                id: format!("grid-{learner}-{gap}"),
                description: format!("Error of {} under other label rules, at least {gap} m of path between the scans of a positive pair", name_of(learner)),
                cells: rows.iter().flat_map(|&r| columns.iter().map(move |&c| (r, c))).map(|(r, c)| cell(r, c)).collect(),
                columns: columns.clone(),
                rows: rows.clone(),
                highest,
            });
        }
    }
    heats
}

/// The first two rounds of the first learner that cuts two features at thresholds.
fn scatter(input: &Input<'_>) -> Option<Scatter> {
    let cuts_of = |learner: &str| -> Option<[Cut; 2]> {
        let mut cuts: Vec<Cut> = Vec::new();
        for r in input.rounds.iter().filter(|r| r.left_out.is_none() && r.learner == learner) {
            if cuts.iter().all(|cut| cut.feature != r.feature) {
                let threshold = r.threshold?;
                cuts.push(Cut { feature: r.feature.clone(), round: r.round, threshold });
            }
            if cuts.len() == 2 {
                break;
            }
        }
        cuts.try_into().ok()
    };
    let cuts = distinct(input.rounds.iter().map(|r| &*r.learner)).into_iter().find_map(cuts_of)?;
    let column = |cut: &Cut| input.features.names.iter().position(|name| *name == cut.feature);
    let (x, y) = (column(&cuts[0])?, column(&cuts[1])?);
    let points = |label: Label| -> Vec<[f64; 2]> {
        let of_label = input.pairs.iter().filter(|p| p.label == label);
        of_label
            .map(|p| {
                let (a, b) = (input.features.row(p.query), input.features.row(p.reference));
                [(a[x] - b[x]).abs(), (a[y] - b[y]).abs()]
            })
            .collect()
    };
    let (positive, negative) = (points(Label::Positive), points(Label::Negative));
    Some(Scatter { id: "first-rounds".to_owned(), cuts, positive, negative })
}

fn scan_pairs(input: &Input<'_>, sketches: &Sketches) -> Vec<Figure> {
    let mut figures = Vec::new();
    let mut counts = [0; 4];
    for drawn in &sketches.pairs {
        let pair = &input.pairs[drawn.pair];
        let returns = |k: usize| sketches.returns.get(&k).map_or(&[][..], Vec::as_slice);
        counts[drawn.kind as usize] += 1;
        let id = format!("{}-{}", drawn.kind.id(), counts[drawn.kind as usize]);
        let class = if pair.label == Label::Positive { "same" } else { "another" };
        let id_of = |k: usize| &input.keyframes[k].id;
        let (a, b) = (id_of(pair.query), id_of(pair.reference));
        let text = format!(
            "{}: scan {} of {} and scan {} of {}, confidence {:+.2}",
            drawn.kind.title(),
            a.scan,
            a.log,
            b.scan,
            b.log,
            drawn.confidence
        );
        let svg = scan_pair(&id, class, &text, [returns(pair.query), returns(pair.reference)]);
        figures.push(Figure::new(&id, svg));
    }
    figures
}

impl Kind {
    pub(crate) fn id(self) -> &'static str {
        match self {
            Self::Match => "match",
            Self::NonMatch => "non-match",
            Self::FalseAlarm => "false-alarm",
            Self::Missed => "missed",
        }
    }

    pub(crate) fn title(self) -> &'static str {
        match self {
            Self::Match => "match, found",
            Self::NonMatch => "non-match, told apart",
            Self::FalseAlarm => "non-match, taken for a match",
            Self::Missed => "match, missed",
        }
    }
}
