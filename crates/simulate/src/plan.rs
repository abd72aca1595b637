//! The floor plan of a building, the same on every day.
//!
//! ```text
//!   row 2  o-----------o-----------o     Corridors run along x and y and meet in nodes `o`
//!          | rooms     |     rooms |     (column, row). One node is in the atrium `A`. Rooms line
//!   row 1  o----------[A]----------o     both sides of each corridor, some of them behind glass.
//!          | rooms     |     rooms |     This is a single building of 120 m x 80 m. Buildings on
//!   row 0  o-----------o-----------o     a campus are smaller; they have an entrance below row 0
//!       column 0       1           2     and windows in their facades.
//! ```
//!
//! A corridor is a chain of sections. Each section has its own width, its own mix of rooms, alcoves,
//! pillars and blank wall, and its own room size. Different sections therefore look different.

use crate::plane::{Point, Rect, Segment, Vector};
use crate::random::Random;

/// Thickness of the walls between rooms and corridors \[m\].
const WALL_M: f64 = 0.2;
/// Minimum and maximum width of a corridor section \[m\].
const CORRIDOR_WIDTH_M: (f64, f64) = (1.8, 3.0);
/// Minimum width of corridors with boxes and pillars at their walls \[m\].
const WIDE_M: f64 = 2.4;
/// Radius around nodes without obstacles, because the robot turns there \[m\].
const NODE_CLEAR_M: f64 = 2.5;
/// Depth of the niche of a closed door in the corridor wall \[m\].
const NICHE_M: f64 = 0.05;
/// Maximum distance of a room from the facade for it to have windows \[m\].
const WINDOW_DEPTH_M: f64 = 2.5;
/// Fraction of rooms with a glass front.
const GLASS_SHARE: f64 = 0.2;
/// Minimum distance of the pillars in the atrium from the middle of both corridors \[m\].
const PILLAR_CLEAR_M: f64 = 1.6;

/// Size of a building and number of its corridors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    /// Size along x and y \[m\].
    size_m: (f64, f64),
    columns: usize,
    rows: usize,
    /// Minimum and maximum distance from a facade to the corridor behind it \[m\].
    margin_m: (f64, f64),
    /// Column of the entrance, which is below row 0.
    entrance: Option<usize>,
    atrium: (usize, usize),
    has_windows: bool,
}

impl Shape {
    /// A single building.
    pub(crate) fn alone() -> Self {
        Self {
            size_m: (120.0, 80.0),
            columns: 3,
            rows: 3,
            margin_m: (9.0, 11.0),
            entrance: None,
            atrium: (1, 1),
            has_windows: false,
        }
    }

    /// A building on a campus.
    pub(crate) fn on_campus(random: &mut Random) -> Self {
        let size = (random.uniform(46.0, 66.0), random.uniform(34.0, 44.0));
        let columns = if 55.0 < size.0 { 3 } else { 2 };
        Self {
            size_m: (size.0.round(), size.1.round()),
            columns,
            rows: 2,
            margin_m: (6.5, 8.0),
            entrance: Some(random.index(columns)),
            atrium: (random.index(columns), random.index(2)),
            has_windows: true,
        }
    }
}

/// The permanent part of a building.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// The outline of the building.
    pub(crate) building: Rect,
    /// Where corridors meet: `nodes[column][row]`.
    pub(crate) nodes: Vec<Vec<Point>>,
    /// Column of the entrance.
    pub(crate) entrance: Option<usize>,
    pub(crate) sections: Vec<Section>,
    pub(crate) atrium: Rect,
    /// Height of the ceiling of corridors and rooms \[m\].
    pub(crate) ceiling_m: f64,
    /// Height of the ceiling of the atrium \[m\].
    pub(crate) atrium_ceiling_m: f64,
    /// Height of the roof \[m\].
    pub(crate) roof_m: f64,
    /// Reflectivity of the walls.
    pub(crate) reflectivity: f64,
    /// Free space except doors: corridors, nodes, the atrium, alcoves, rooms.
    pub(crate) open: Vec<Rect>,
    /// Pillars at corridor walls, inside the free space.
    pub(crate) solid: Vec<Rect>,
    pub(crate) doors: Vec<Door>,
    /// Glass fronts from floor to ceiling, between rooms and corridors.
    pub(crate) glass: Vec<Segment>,
    /// Windows in the facades.
    pub(crate) windows: Vec<Segment>,
    /// Openings in the facades.
    pub(crate) entrances: Vec<Segment>,
    pub(crate) furniture: Vec<Furniture>,
    /// Round pillars in the atrium.
    pub(crate) pillars: Vec<Pillar>,
    has_windows: bool,
}

/// A part of a corridor with constant width.
#[derive(Debug, Clone)]
pub(crate) struct Section {
    line: Line,
    /// Start along the line \[m\].
    from_m: f64,
    /// End along the line \[m\].
    to_m: f64,
    /// Width \[m\].
    pub(crate) width_m: f64,
}

/// A door from a corridor into a room.
#[derive(Debug, Clone)]
pub(crate) struct Door {
    /// Free space when the door is open: through the wall.
    pub(crate) passage: Rect,
    /// Free space when the door is closed: a niche as deep as the frame.
    pub(crate) niche: Rect,
    /// The wall above the door.
    pub(crate) lintel: Segment,
    /// Probability that the door is open on a given day.
    pub(crate) open_share: f64,
}

/// A piece of furniture in a room.
#[derive(Debug, Clone)]
pub(crate) struct Furniture {
    pub(crate) room: Rect,
    /// Its usual position.
    pub(crate) centre: Point,
    /// Length and depth \[m\].
    pub(crate) size_m: (f64, f64),
    /// Height \[m\].
    pub(crate) height_m: f64,
    /// Orientation \[rad\].
    pub(crate) angle_rad: f64,
    pub(crate) reflectivity: f64,
}

/// A round pillar.
#[derive(Debug, Clone)]
pub(crate) struct Pillar {
    pub(crate) centre: Point,
    /// Radius \[m\].
    pub(crate) radius_m: f64,
}

/// The centre line of a corridor: parallel to x at y = `across_m`, or parallel to y at
/// x = `across_m`.
#[derive(Debug, Clone, Copy)]
struct Line {
    is_along_x: bool,
    across_m: f64,
}

impl Line {
    /// The point at `along` the line and `aside` of it \[m\].
    fn point(&self, along: f64, aside: f64) -> Point {
        match self.is_along_x {
            true => Point::new(along, self.across_m + aside),
            false => Point::new(self.across_m + aside, along),
        }
    }

    fn rect(&self, along: (f64, f64), aside: (f64, f64)) -> Rect {
        Rect::new(self.point(along.0, aside.0), self.point(along.1, aside.1))
    }
}

impl Section {
    /// Length \[m\].
    pub(crate) fn length_m(&self) -> f64 {
        self.to_m - self.from_m
    }

    /// The floor of the section.
    fn floor(&self) -> Rect {
        self.line.rect((self.from_m, self.to_m), (-self.width_m / 2.0, self.width_m / 2.0))
    }

    /// A box of the given length and depth at one of the walls (`side` is -1 or 1). `at`, from 0 to 1,
    /// is its position along the section. `None` if the section is too narrow or too short.
    pub(crate) fn box_at_wall(&self, at: f64, side: f64, length: f64, depth: f64) -> Option<Rect> {
        let (from, to) = (self.from_m + NODE_CLEAR_M, self.to_m - NODE_CLEAR_M - length);
        let along = from + at * (to - from);
        let wall = side * self.width_m / 2.0;
        (WIDE_M <= self.width_m && from < to)
            .then(|| self.line.rect((along, along + length), (wall - side * depth, wall)))
    }
}

impl Plan {
    pub(crate) fn new(shape: &Shape, random: &mut Random) -> Self {
        let nodes = draw_nodes(shape, random);
        let mut sections = draw_sections(&nodes, random);
        let mut entrances = Vec::new();
        if let Some(column) = shape.entrance {
            let (x, y) = (nodes[column][0].x, nodes[column][0].y);
            let line = Line { is_along_x: false, across_m: x };
            let width = random.uniform(2.4, 3.0);
            sections.push(Section { line, from_m: 0.0, to_m: y + 0.001, width_m: width });
            entrances.push(Segment {
                start: Point::new(x - width / 2.0, 0.0),
                end: Point::new(x + width / 2.0, 0.0),
            });
        }
        let hall = nodes[shape.atrium.0][shape.atrium.1];
        let reach = f64::min(shape.margin_m.0 - 0.5, 7.5);
        let atrium = Rect::centred(
            hall + Vector::new(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0)),
            random.uniform(1.5 * reach, 2.0 * reach - 2.0),
            random.uniform(1.2 * reach, 2.0 * reach - 2.0),
        );
        let mut open: Vec<Rect> = sections.iter().map(Section::floor).collect();
        open.extend(node_floors(&nodes, &sections));
        open.push(atrium);
        let atrium_ceiling_m = random.uniform(4.5, 7.0);
        let mut plan = Self {
            building: Rect::new(Point::origin(), Point::new(shape.size_m.0, shape.size_m.1)),
            sections,
            entrance: shape.entrance,
            atrium,
            ceiling_m: random.uniform(2.5, 3.0),
            atrium_ceiling_m,
            roof_m: atrium_ceiling_m + random.uniform(1.0, 6.0),
            reflectivity: random.uniform(0.35, 0.8),
            open,
            solid: Vec::new(),
            doors: Vec::new(),
            glass: Vec::new(),
            windows: Vec::new(),
            entrances,
            furniture: Vec::new(),
            pillars: draw_pillars(hall, &atrium, random),
            has_windows: shape.has_windows,
            nodes,
        };
        for section in plan.sections.clone() {
            let style = WallStyle::draw(&section, random);
            for side in [-1.0, 1.0] {
                plan.line_wall(&section, &style, side, random);
            }
        }
        plan
    }

    /// Adds rooms, alcoves, pillars and blank wall along one side of a section.
    fn line_wall(&mut self, section: &Section, style: &WallStyle, side: f64, random: &mut Random) {
        let mut along = section.from_m + 0.3;
        // An element that is too long for the rest of the section is drawn again, a few times.
        let mut n_too_long = 0;
        while n_too_long < 4 {
            let [room, alcove, pillar] = style.shares;
            let pick = random.uniform(0.0, 1.0);
            let length = if pick < room {
                style.room_length_m * random.uniform(0.7, 1.4)
            } else if pick < room + alcove {
                random.uniform(1.0, 3.5)
            } else {
                random.uniform(0.4, 1.8)
            };
            let span = (along, along + length);
            if section.to_m - 0.3 < span.1 {
                n_too_long += 1;
                continue;
            }
            if pick < room {
                self.add_room(section, span, side, random);
            } else if pick < room + alcove {
                self.add_alcove(section, span, side, random);
            } else if pick < room + alcove + pillar {
                self.add_wall_pillar(section, span.0, side, random);
            }
            along = span.1 + WALL_M;
        }
    }

    /// Adds a room with its door and furniture, as deep as the space allows, or nothing if there is no
    /// space.
    fn add_room(&mut self, section: &Section, span: (f64, f64), side: f64, random: &mut Random) {
        let wall = side * section.width_m / 2.0;
        let depth = random.uniform(2.5, 7.5);
        let open_share = [0.2, 0.6, 0.95][random.index(3)];
        let rooms = [1.0, 0.75, 0.5].map(|share| {
            section.line.rect(span, (wall + side * WALL_M, wall + side * (WALL_M + share * depth)))
        });
        let has_space = |room: &&Rect| 2.0 <= room.width().min(room.height()) && self.is_free(room);
        let Some(&room) = rooms.iter().find(has_space) else {
            return;
        };
        self.open.push(room);
        if self.has_windows {
            self.add_windows(&room);
        }

        let is_double = 5.0 <= span.1 - span.0 && random.chance(0.3);
        let width = if is_double { random.uniform(1.6, 2.0) } else { random.uniform(0.9, 1.1) };
        let from = random.uniform(span.0 + 0.2, span.1 - 0.2 - width);
        let at = |along, depth| section.line.point(along, wall + side * depth);
        let door = |depth| section.line.rect((from, from + width), (wall, wall + side * depth));
        if random.chance(GLASS_SHARE) {
            // The whole front is glass, with a gap at the open door.
            let front = (span.0 + 0.1, span.1 - 0.1);
            self.open.push(section.line.rect(front, (wall, wall + side * WALL_M)));
            for (a, b) in [(front.0, from), (from + width, front.1)] {
                let depth = WALL_M / 2.0;
                self.glass.push(Segment { start: at(a, depth), end: at(b, depth) });
            }
        } else {
            let lintel = Segment { start: at(from, 0.0), end: at(from + width, 0.0) };
            self.doors.push(Door {
                passage: door(WALL_M),
                niche: door(NICHE_M),
                lintel,
                open_share,
            });
        }

        let n_furniture = random.index(((room.width() * room.height() / 6.0) as usize).clamp(1, 6));
        for _ in 0..n_furniture {
            self.furniture.push(Furniture {
                room,
                centre: Point::new(
                    random.uniform(room.x0, room.x1),
                    random.uniform(room.y0, room.y1),
                ),
                size_m: (random.uniform(0.4, 1.8), random.uniform(0.3, 0.8)),
                // Table, desk with a screen, shelf, cupboard.
                height_m: [0.74, 1.2, 1.6, 2.0][random.index(4)],
                reflectivity: random.uniform(0.02, 0.7),
                angle_rad: [0.0, std::f64::consts::FRAC_PI_2][random.index(2)]
                    + 0.1 * random.normal(),
            });
        }
    }

    /// Adds windows to the facades near a room.
    fn add_windows(&mut self, room: &Rect) {
        let building = self.building;
        let (x0, x1) = (room.x0 + 0.4, room.x1 - 0.4);
        let (y0, y1) = (room.y0 + 0.4, room.y1 - 0.4);
        let p = Point::new;
        // Corners of the space between the room and the facade, and ends of the window.
        let candidates = [
            (p(x0, building.y0), p(x1, room.y0), p(x0, building.y0), p(x1, building.y0)),
            (p(x0, room.y1), p(x1, building.y1), p(x0, building.y1), p(x1, building.y1)),
            (p(building.x0, y0), p(room.x0, y1), p(building.x0, y0), p(building.x0, y1)),
            (p(room.x1, y0), p(building.x1, y1), p(building.x1, y0), p(building.x1, y1)),
        ];
        for (low, high, start, end) in candidates {
            let reveal = Rect::new(low, high);
            let depth = (high - low).norm_squared() - (end - start).norm_squared();
            let is_free = self.open.iter().all(|open| open == room || !reveal.overlaps(open));
            if 0.5 <= (end - start).norm() && depth < WINDOW_DEPTH_M * WINDOW_DEPTH_M && is_free {
                self.open.push(reveal);
                let edge = Rect::new(start, end);
                self.windows.push(Segment { start: p(edge.x0, edge.y0), end: p(edge.x1, edge.y1) });
            }
        }
    }

    fn add_alcove(&mut self, section: &Section, span: (f64, f64), side: f64, random: &mut Random) {
        let wall = section.width_m / 2.0;
        let depth = random.uniform(0.4, 1.6);
        // The opening touches the corridor, so only the deeper part must be free.
        let deeper = section.line.rect(span, (side * (wall + 0.16), side * (wall + depth)));
        if self.is_free(&deeper) {
            self.open.push(section.line.rect(span, (side * wall, side * (wall + depth))));
        }
    }

    fn add_wall_pillar(&mut self, section: &Section, along: f64, side: f64, random: &mut Random) {
        let (width, depth) = (random.uniform(0.3, 0.6), random.uniform(0.15, 0.3));
        let wall = side * section.width_m / 2.0;
        let pillar = section.line.rect((along, along + width), (wall - side * depth, wall));
        let is_clear_of_nodes =
            section.from_m + NODE_CLEAR_M <= along && along + width <= section.to_m - NODE_CLEAR_M;
        if WIDE_M <= section.width_m && is_clear_of_nodes && !pillar.overlaps(&self.atrium) {
            self.solid.push(pillar);
        }
    }

    /// Whether a new space with its walls overlaps no other space and is inside the building.
    fn is_free(&self, space: &Rect) -> bool {
        // Slightly less than the thickness of a wall, to tolerate rounding.
        let walled = space.grown(0.75 * WALL_M);
        walled.is_inside(&self.building) && self.open.iter().all(|other| !walled.overlaps(other))
    }
}

/// Style of the walls of a section.
struct WallStyle {
    /// Probabilities of rooms, alcoves and pillars; the rest is blank wall.
    shares: [f64; 3],
    room_length_m: f64,
}

impl WallStyle {
    fn draw(section: &Section, random: &mut Random) -> Self {
        let pillars = if WIDE_M <= section.width_m { random.uniform(0.0, 0.3) } else { 0.0 };
        Self {
            shares: [random.uniform(0.4, 0.75), random.uniform(0.0, 0.2), pillars],
            room_length_m: random.uniform(2.8, 7.0),
        }
    }
}

/// The nodes where corridors cross. The blocks between them differ in size. The diagonal of the
/// smallest block of a single building is more than 50 m.
fn draw_nodes(shape: &Shape, random: &mut Random) -> Vec<Vec<Point>> {
    let mut lines = |size: f64, n: usize| -> Vec<f64> {
        let first = random.uniform(shape.margin_m.0, shape.margin_m.1);
        let last = size - random.uniform(shape.margin_m.0, shape.margin_m.1);
        let mut lines = vec![first, last];
        if n == 3 {
            lines.insert(1, first + random.uniform(0.46, 0.54) * (last - first));
        }
        lines
    };
    let xs = lines(shape.size_m.0, shape.columns);
    let ys = lines(shape.size_m.1, shape.rows);
    xs.iter().map(|&x| ys.iter().map(|&y| Point::new(x, y)).collect()).collect()
}

/// The corridors between neighbouring nodes, each in the positive direction of its axis.
pub(crate) fn corridors(nodes: &[Vec<Point>]) -> Vec<(Point, Point)> {
    let along_y = nodes.iter().flat_map(|column| column.windows(2)).map(|ab| (ab[0], ab[1]));
    let columns = nodes.windows(2).map(|ab| (&ab[0], &ab[1]));
    let along_x = columns.flat_map(|(a, b)| a.iter().copied().zip(b.iter().copied()));
    along_x.chain(along_y).collect()
}

/// Divides every corridor between two nodes into sections of about 14 m.
fn draw_sections(nodes: &[Vec<Point>], random: &mut Random) -> Vec<Section> {
    let mut sections = Vec::new();
    for (a, b) in corridors(nodes) {
        let is_along_x = b.y - a.y < b.x - a.x;
        let (line, from, to) = if is_along_x {
            (Line { is_along_x, across_m: a.y }, a.x, b.x)
        } else {
            (Line { is_along_x, across_m: a.x }, a.y, b.y)
        };
        let n = ((to - from) / 14.0).round().max(1.0) as usize;
        let mut start = from;
        for k in 1..=n {
            let jitter = if k < n { random.uniform(-0.25, 0.25) } else { 0.0 };
            let end = from + (k as f64 + jitter) / n as f64 * (to - from);
            let width = random.uniform(CORRIDOR_WIDTH_M.0, CORRIDOR_WIDTH_M.1);
            // An overlap of 1 mm joins the floors despite rounding.
            sections.push(Section { line, from_m: start, to_m: end + 0.001, width_m: width });
            start = end;
        }
    }
    sections
}

/// The floor at each node: a square as wide as the widest section that ends there.
fn node_floors(nodes: &[Vec<Point>], sections: &[Section]) -> Vec<Rect> {
    let floor = |node: &Point| {
        let reach = Rect::centred(*node, 1.0, 1.0);
        let widths = sections.iter().filter(|s| s.floor().overlaps(&reach)).map(|s| s.width_m);
        let width = widths.fold(CORRIDOR_WIDTH_M.0, f64::max);
        Rect::centred(*node, width, width)
    };
    nodes.iter().flatten().map(floor).collect()
}

/// Up to four pillars around the middle of the atrium, clear of both corridors through it.
fn draw_pillars(node: Point, atrium: &Rect, random: &mut Random) -> Vec<Pillar> {
    let (dx, dy) = (atrium.width() * 0.3, atrium.height() * 0.33);
    let radius = random.uniform(0.2, 0.4);
    let corners = [(-dx, -dy), (dx, -dy), (dx, dy), (-dx, dy)];
    corners
        .into_iter()
        .map(|(dx, dy)| atrium.centre() + Vector::new(dx, dy))
        .filter(|centre| {
            let aside = (centre - node).abs();
            PILLAR_CLEAR_M + radius <= aside.x.min(aside.y)
        })
        .map(|centre| Pillar { centre, radius_m: radius })
        .collect()
}
