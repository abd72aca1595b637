//! The floor plan of the building, the same on every day.
//!
//! ```text
//!   row 2  o-----------o-----------o     Three corridors run along x and three along y; they meet
//!          | rooms     |     rooms |     in nodes `o` (column, row). The outer ones close a ring,
//!   row 1  o----------[A]----------o     the inner ones cross in an atrium `A`. Rooms line both
//!          | rooms     |     rooms |     sides of each corridor. About 120 m x 80 m.
//!   row 0  o-----------o-----------o
//!       column 0       1           2
//! ```
//!
//! A corridor is a chain of sections; each has its own width, its own share of rooms, alcoves,
//! pillars and blank wall, and its own size of rooms, so that no two look alike.

use crate::random::Random;
use crate::walls::{Point, Rect, Vector};

/// Size of the building \[m\].
const BUILDING_M: (f64, f64) = (120.0, 80.0);
/// Thickness of the walls between rooms and corridors \[m\].
const WALL_M: f64 = 0.2;
/// Width of a corridor section \[m\].
const CORRIDOR_WIDTH_M: (f64, f64) = (1.8, 3.0);
/// Corridors at least as wide as this have things standing at their walls \[m\].
const WIDE_M: f64 = 2.4;
/// Around nodes nothing stands in the way: the robot turns there \[m\].
const NODE_CLEAR_M: f64 = 2.5;
/// Depth of the niche that a closed door leaves in the corridor's wall \[m\].
const NICHE_M: f64 = 0.05;
/// Pillars of the atrium keep this far from the middle of both corridors \[m\].
const PILLAR_CLEAR_M: f64 = 1.6;

/// The part of a building that stays.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// Where corridors meet, `nodes[column][row]`.
    pub(crate) nodes: [[Point; 3]; 3],
    pub(crate) sections: Vec<Section>,
    pub(crate) atrium: Rect,
    /// Free space besides doors: corridors, nodes, the atrium, alcoves, rooms.
    pub(crate) open: Vec<Rect>,
    /// What stands in it: pillars at corridor walls.
    pub(crate) solid: Vec<Rect>,
    pub(crate) doors: Vec<Door>,
    pub(crate) furniture: Vec<Furniture>,
    /// Round pillars in the atrium.
    pub(crate) pillars: Vec<Pillar>,
}

/// A stretch of corridor of one width.
#[derive(Debug, Clone)]
pub(crate) struct Section {
    line: Line,
    /// From and to, along the line \[m\].
    from: f64,
    to: f64,
    /// \[m\]
    pub(crate) width: f64,
}

/// A door from a corridor into a room.
#[derive(Debug, Clone)]
pub(crate) struct Door {
    /// Free space when open: through the wall.
    pub(crate) passage: Rect,
    /// Free space when closed: a niche as deep as the frame.
    pub(crate) niche: Rect,
    /// Share of days on which it is open.
    pub(crate) open_share: f64,
}

/// A box in a room.
#[derive(Debug, Clone)]
pub(crate) struct Furniture {
    pub(crate) room: Rect,
    /// Where it usually stands.
    pub(crate) centre: Point,
    /// \[m\]
    pub(crate) size: (f64, f64),
    /// \[rad\]
    pub(crate) angle: f64,
}

/// A round pillar.
#[derive(Debug, Clone)]
pub(crate) struct Pillar {
    pub(crate) centre: Point,
    pub(crate) radius: f64,
}

/// The middle of a corridor: parallel to x at y = `across`, or parallel to y at x = `across`.
#[derive(Debug, Clone, Copy)]
struct Line {
    is_along_x: bool,
    across: f64,
}

impl Line {
    /// From `along` the line and `aside` of it \[m\].
    fn point(&self, along: f64, aside: f64) -> Point {
        match self.is_along_x {
            true => Point::new(along, self.across + aside),
            false => Point::new(self.across + aside, along),
        }
    }

    fn rect(&self, along: (f64, f64), aside: (f64, f64)) -> Rect {
        Rect::new(self.point(along.0, aside.0), self.point(along.1, aside.1))
    }
}

impl Section {
    /// The section's floor.
    fn floor(&self) -> Rect {
        self.line.rect((self.from, self.to), (-self.width / 2.0, self.width / 2.0))
    }

    /// A box of the given length and depth at one of the walls (`side` is -1 or 1), `at` a share
    /// of the way along, where the section is wide enough for something to stand in it.
    pub(crate) fn box_at_wall(&self, at: f64, side: f64, length: f64, depth: f64) -> Option<Rect> {
        let (from, to) = (self.from + NODE_CLEAR_M, self.to - NODE_CLEAR_M - length);
        let along = from + at * (to - from);
        let wall = side * self.width / 2.0;
        (WIDE_M <= self.width && from < to)
            .then(|| self.line.rect((along, along + length), (wall - side * depth, wall)))
    }
}

impl Plan {
    pub(crate) fn new(random: &mut Random) -> Self {
        let nodes = draw_nodes(random);
        let sections = draw_sections(&nodes, random);
        let atrium = Rect::centred(
            nodes[1][1] + Vector::new(random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0)),
            random.uniform(12.0, 18.0),
            random.uniform(9.0, 14.0),
        );
        let mut open: Vec<Rect> = sections.iter().map(Section::floor).collect();
        open.extend(node_floors(&nodes, &sections));
        open.push(atrium);
        let mut plan = Self {
            nodes,
            sections,
            atrium,
            open,
            solid: Vec::new(),
            doors: Vec::new(),
            furniture: Vec::new(),
            pillars: draw_pillars(nodes[1][1], &atrium, random),
        };
        for section in plan.sections.clone() {
            let look = Look::draw(&section, random);
            for side in [-1.0, 1.0] {
                plan.line_wall(&section, &look, side, random);
            }
        }
        plan
    }

    /// Lines one side of a section with rooms, alcoves, pillars and blank wall.
    fn line_wall(&mut self, section: &Section, look: &Look, side: f64, random: &mut Random) {
        let mut along = section.from + 0.3;
        // What is too long for the rest of the section is drawn anew, a few times.
        let mut n_too_long = 0;
        while n_too_long < 4 {
            let [room, alcove, pillar] = look.shares;
            let pick = random.uniform(0.0, 1.0);
            let length = if pick < room {
                look.room_length_m * random.uniform(0.7, 1.4)
            } else if pick < room + alcove {
                random.uniform(1.0, 3.5)
            } else {
                random.uniform(0.4, 1.8)
            };
            let span = (along, along + length);
            if section.to - 0.3 < span.1 {
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

    /// A room with its door and furniture, as deep as there is space for; none where there is not.
    fn add_room(&mut self, section: &Section, span: (f64, f64), side: f64, random: &mut Random) {
        let wall = side * section.width / 2.0;
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

        let is_double = 5.0 <= span.1 - span.0 && random.chance(0.3);
        let width = if is_double { random.uniform(1.6, 2.0) } else { random.uniform(0.9, 1.1) };
        let from = random.uniform(span.0 + 0.2, span.1 - 0.2 - width);
        let door = |depth| section.line.rect((from, from + width), (wall, wall + side * depth));
        self.doors.push(Door { passage: door(WALL_M), niche: door(NICHE_M), open_share });

        let n_furniture = random.index(((room.width() * room.height() / 6.0) as usize).clamp(1, 6));
        for _ in 0..n_furniture {
            self.furniture.push(Furniture {
                room,
                centre: Point::new(
                    random.uniform(room.x0, room.x1),
                    random.uniform(room.y0, room.y1),
                ),
                size: (random.uniform(0.4, 1.8), random.uniform(0.3, 0.8)),
                angle: [0.0, std::f64::consts::FRAC_PI_2][random.index(2)] + 0.1 * random.normal(),
            });
        }
    }

    fn add_alcove(&mut self, section: &Section, span: (f64, f64), side: f64, random: &mut Random) {
        let wall = section.width / 2.0;
        let depth = random.uniform(0.4, 1.6);
        // Its mouth touches the corridor, so only what lies deeper must be free.
        let deeper = section.line.rect(span, (side * (wall + 0.16), side * (wall + depth)));
        if self.is_free(&deeper) {
            self.open.push(section.line.rect(span, (side * wall, side * (wall + depth))));
        }
    }

    fn add_wall_pillar(&mut self, section: &Section, along: f64, side: f64, random: &mut Random) {
        let (width, depth) = (random.uniform(0.3, 0.6), random.uniform(0.15, 0.3));
        let wall = side * section.width / 2.0;
        let pillar = section.line.rect((along, along + width), (wall - side * depth, wall));
        let is_clear_of_nodes =
            section.from + NODE_CLEAR_M <= along && along + width <= section.to - NODE_CLEAR_M;
        if WIDE_M <= section.width && is_clear_of_nodes && !pillar.overlaps(&self.atrium) {
            self.solid.push(pillar);
        }
    }

    /// Whether a new space, with walls around it, meets no other and stays inside the building.
    fn is_free(&self, space: &Rect) -> bool {
        // A little less than a wall, for rounding.
        let walled = space.grown(0.75 * WALL_M);
        let building = Rect::new(Point::origin(), Point::new(BUILDING_M.0, BUILDING_M.1));
        walled.is_inside(&building) && self.open.iter().all(|other| !walled.overlaps(other))
    }
}

/// What the walls of a section look like.
struct Look {
    /// Shares of rooms, alcoves and pillars; the rest is blank.
    shares: [f64; 3],
    room_length_m: f64,
}

impl Look {
    fn draw(section: &Section, random: &mut Random) -> Self {
        let pillars = if WIDE_M <= section.width { random.uniform(0.0, 0.3) } else { 0.0 };
        Self {
            shares: [random.uniform(0.4, 0.75), random.uniform(0.0, 0.2), pillars],
            room_length_m: random.uniform(2.8, 7.0),
        }
    }
}

/// The corridors' crossings; the blocks between differ in size, and the smallest is still more
/// than 50 m from corner to corner.
fn draw_nodes(random: &mut Random) -> [[Point; 3]; 3] {
    let mut lines = |size: f64, middle: (f64, f64)| {
        let first = random.uniform(9.0, 11.0);
        let last = size - random.uniform(9.0, 11.0);
        [first, first + random.uniform(middle.0, middle.1), last]
    };
    let xs = lines(BUILDING_M.0, (46.0, 56.0));
    let ys = lines(BUILDING_M.1, (26.0, 34.0));
    xs.map(|x| ys.map(|y| Point::new(x, y)))
}

/// From node to node along every corridor, in the direction of its axis: 12 pairs.
pub(crate) fn corridors(nodes: &[[Point; 3]; 3]) -> Vec<(Point, Point)> {
    let along_y = nodes.iter().flat_map(|column| column.windows(2)).map(|ab| (ab[0], ab[1]));
    let columns = nodes.windows(2).map(|ab| (ab[0], ab[1]));
    let along_x = columns.flat_map(|(a, b)| a.into_iter().zip(b));
    along_x.chain(along_y).collect()
}

/// Every corridor between two nodes as sections of about 14 m.
fn draw_sections(nodes: &[[Point; 3]; 3], random: &mut Random) -> Vec<Section> {
    let mut sections = Vec::new();
    for (a, b) in corridors(nodes) {
        let is_along_x = b.y - a.y < b.x - a.x;
        let (line, from, to) = if is_along_x {
            (Line { is_along_x, across: a.y }, a.x, b.x)
        } else {
            (Line { is_along_x, across: a.x }, a.y, b.y)
        };
        let n = ((to - from) / 14.0).round() as usize;
        let mut start = from;
        for k in 1..=n {
            let jitter = if k < n { random.uniform(-0.25, 0.25) } else { 0.0 };
            let end = from + (k as f64 + jitter) / n as f64 * (to - from);
            let width = random.uniform(CORRIDOR_WIDTH_M.0, CORRIDOR_WIDTH_M.1);
            // A millimetre of overlap joins the floors whatever the rounding.
            sections.push(Section { line, from: start, to: end + 0.001, width });
            start = end;
        }
    }
    sections
}

/// A square at each node, as wide as the widest section that ends there.
fn node_floors(nodes: &[[Point; 3]; 3], sections: &[Section]) -> Vec<Rect> {
    let floor = |node: &Point| {
        let reach = Rect::centred(*node, 1.0, 1.0);
        let widths = sections.iter().filter(|s| s.floor().overlaps(&reach)).map(|s| s.width);
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
        .map(|centre| Pillar { centre, radius })
        .collect()
}
