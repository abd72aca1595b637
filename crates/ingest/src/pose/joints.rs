//! Joint names -> the driven wheels on the left and on the right.

use std::collections::BTreeSet;

use crate::wheel_options::WheelsTopic;

/// Parts of names of joints that do not drive the robot. The words are in the joint names of
/// the URDF models of PR2, TIAGo, HSR, Fetch, UR, Husky, MiR, YouBot, rovers and legged robots.
const OTHER_JOINTS: [&str; 34] = [
    "ankle",
    "arm",
    "bogie",
    "brake",
    "camera",
    "caster",
    "castor",
    "door",
    "elbow",
    "finger",
    "flipper",
    "gripper",
    "hand",
    "head",
    "hinge",
    "hip",
    "knee",
    "knuckle",
    "leg",
    "lift",
    "neck",
    "pan",
    "rocker",
    "roller",
    "rotation",
    "shock",
    "shoulder",
    "spring",
    "steer",
    "suspension",
    "swivel",
    "thumb",
    "tilt",
    "wrist",
];
/// Those of the words above that are short enough to be part of another word: they are only
/// compared with whole words.
const WHOLE_WORDS: [&str; 9] = ["arm", "hand", "head", "hip", "leg", "lift", "pan", "tilt", "door"];
/// Words for a driven wheel, without the word wheel.
const DRIVES: [&str; 7] = ["drive", "motor", "tire", "tyre", "track", "tread", "crawler"];
/// Short names of the corners and sides of a robot: front, rear, back and middle, left and right.
const SHORT_SIDES: [&str; 18] = [
    "l", "r", "fl", "fr", "rl", "rr", "bl", "br", "ml", "mr", "lf", "rf", "lr", "lb", "rb", "lm",
    "rm", "cl",
];

/// A side of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Left,
    Right,
}

/// How clearly joints are named as wheels. The clearest ones of a topic are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Naming {
    /// Named in the options, or their names contain `wheel`.
    Wheel,
    /// Their names contain another word for a driven wheel, such as `motor`.
    Drive,
    /// Their names only contain `left` and `right`.
    Side,
}

/// The wheels of a `JointState` message: indices into its names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct WheelJoints {
    pub(crate) naming: Naming,
    pub(crate) left: Vec<usize>,
    pub(crate) right: Vec<usize>,
}

/// Why a message has no usable wheels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum JointFault {
    /// No joint is a wheel with a side.
    None,
    /// The two sides have different numbers of wheels.
    Unequal { n_left: usize, n_right: usize },
}

impl WheelJoints {
    /// Finds the driven wheels among joints. The options can name them.
    ///
    /// Joints of grippers, arms, casters and steering are never wheels, even if `wheel` is part of
    /// their names. Joints whose names contain `wheel` are preferred to all others.
    pub(crate) fn find(names: &[String], options: &WheelsTopic) -> Result<Self, JointFault> {
        if options.names_joints() {
            let indices = |wanted: &[String]| -> Vec<usize> {
                wanted.iter().filter_map(|name| names.iter().position(|n| n == name)).collect()
            };
            let (left, right) = (indices(&options.left), indices(&options.right));
            let is_complete =
                left.len() == options.left.len() && right.len() == options.right.len();
            return match is_complete {
                true => Ok(Self { naming: Naming::Wheel, left, right }.sorted(names)),
                false => Err(JointFault::None),
            };
        }
        let named: Vec<(usize, Naming, Side)> = names
            .iter()
            .enumerate()
            .filter_map(|(k, name)| naming(name).map(|(naming, side)| (k, naming, side)))
            .collect();
        let Some(best) = named.iter().map(|(_, naming, _)| *naming).min() else {
            return Err(JointFault::None);
        };
        let on = |wanted: Side| -> Vec<usize> {
            let of_side =
                named.iter().filter(|(_, naming, side)| (*naming, *side) == (best, wanted));
            of_side.map(|(k, ..)| *k).collect()
        };
        let (left, right) = (on(Side::Left), on(Side::Right));
        match left.len() == right.len() {
            true => Ok(Self { naming: best, left, right }.sorted(names)),
            false => Err(JointFault::Unequal { n_left: left.len(), n_right: right.len() }),
        }
    }

    /// The same wheels in alphabetical order of their names: publishers can change the order.
    fn sorted(mut self, names: &[String]) -> Self {
        self.left.sort_by_key(|&k| &names[k]);
        self.right.sort_by_key(|&k| &names[k]);
        self
    }

    /// The names of the joints on one side.
    pub(crate) fn names(side: &[usize], all: &[String]) -> Vec<String> {
        side.iter().map(|&k| all[k].clone()).collect()
    }
}

/// The wheels in the messages of a topic, given the names in each kind of message: all joints, then the
/// left and the right wheels of the messages with the clearest names.
pub(crate) fn wheels_of_topic(kinds: &BTreeSet<Vec<String>>) -> [Vec<String>; 3] {
    let options = WheelsTopic::default();
    let of_kind = |names: &Vec<String>| {
        let found = WheelJoints::find(names, &options).ok()?;
        let side = |side: &[usize]| side.iter().map(|&k| names[k].clone()).collect::<Vec<_>>();
        Some((found.naming, side(&found.left), side(&found.right)))
    };
    let found: Vec<_> = kinds.iter().filter_map(of_kind).collect();
    let best = found.iter().map(|(naming, ..)| *naming).min();
    let all: BTreeSet<&String> = kinds.iter().flatten().collect();
    let mut joints = [all.into_iter().cloned().collect(), Vec::new(), Vec::new()];
    for (_, left, right) in found.into_iter().filter(|(naming, ..)| Some(*naming) == best) {
        joints[1].extend(left);
        joints[2].extend(right);
    }
    joints
}

/// How a joint is named as a wheel, and on which side it is; `None` if it is not a driven wheel.
fn naming(name: &str) -> Option<(Naming, Side)> {
    let words = words(name);
    let is_other = |word: &String| {
        OTHER_JOINTS.iter().any(|other| match WHOLE_WORDS.contains(other) {
            true => word == other || [format!("l{other}"), format!("r{other}")].contains(word),
            false => word.contains(other),
        })
    };
    if words.iter().any(is_other) {
        return None;
    }
    let contains = |part: &str| words.iter().any(|word| word.contains(part));
    let naming = if contains("wheel") || contains("whl") {
        Naming::Wheel
    } else if DRIVES.into_iter().any(contains) {
        Naming::Drive
    } else {
        Naming::Side
    };
    Some((naming, side(&words, naming)?))
}

/// The side in the words of a name: `left` or `right`, or, for wheels, a short name such as `fl` or
/// `lwheel`. `None` if the words contradict each other.
fn side(words: &[String], naming: Naming) -> Option<Side> {
    let unique = |is_left: bool, is_right: bool| match (is_left, is_right) {
        (true, false) => Some(Side::Left),
        (false, true) => Some(Side::Right),
        _ => None,
    };
    let has = |word: &str| words.iter().any(|w| w == word);
    if has("left") || has("right") {
        return unique(has("left"), has("right"));
    }
    if naming == Naming::Side {
        return None;
    }
    let short = |is_left: bool| {
        words.iter().any(|word| {
            let word = ["wheel", "whl", "motor", "drive"]
                .iter()
                .find_map(|drive| word.strip_suffix(drive).filter(|rest| !rest.is_empty()))
                .unwrap_or(word);
            SHORT_SIDES.contains(&word) && word.contains('l') == is_left
        })
    };
    unique(short(true), short(false))
}

/// The words of a name in lower case. Words end at signs, digits, capital letters after small ones,
/// and around `left` and `right`.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut was_small = false;
    for c in name.chars() {
        if !c.is_alphabetic() || (was_small && c.is_uppercase()) {
            words.push(String::new());
        }
        if let (true, Some(word)) = (c.is_alphabetic(), words.last_mut()) {
            word.extend(c.to_lowercase());
        }
        was_small = c.is_lowercase();
    }
    words.into_iter().flat_map(|word| around_sides(&word)).filter(|w| !w.is_empty()).collect()
}

/// Splits a word before and after `left` and `right` at its start or end, unless the rest is an
/// English word that ends with them, such as `bright`.
fn around_sides(word: &str) -> Vec<String> {
    const ENDS_WITH_A_SIDE: [&str; 5] = ["bright", "upright", "wright", "cleft", "fright"];
    for side in ["left", "right"] {
        if ENDS_WITH_A_SIDE.contains(&word) {
            break;
        }
        if let Some(rest) = word.strip_prefix(side) {
            return vec![side.to_owned(), rest.to_owned()];
        }
        if let Some(rest) = word.strip_suffix(side) {
            return vec![rest.to_owned(), side.to_owned()];
        }
    }
    vec![word.to_owned()]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(names: &[&str]) -> Result<[Vec<String>; 2], JointFault> {
        let names: Vec<String> = names.iter().map(|&name| name.to_owned()).collect();
        let joints = WheelJoints::find(&names, &WheelsTopic::default())?;
        Ok([joints.left, joints.right].map(|side| side.iter().map(|&k| names[k].clone()).collect()))
    }

    fn check(names: &[&str], left: &[&str], right: &[&str]) {
        let found = find(names).unwrap();
        assert_eq!(found, [left, right], "{names:?}");
    }

    /// Joint names of published robot models.
    #[test]
    fn only_driven_wheels_are_used() {
        let tiago = [
            "gripper_left_finger_joint",
            "gripper_right_finger_joint",
            "torso_lift_joint",
            "wheel_left_joint",
            "wheel_right_joint",
        ];
        check(&tiago, &["wheel_left_joint"], &["wheel_right_joint"]);
        let mir = [
            "left_wheel_joint",
            "right_wheel_joint",
            "fl_caster_wheel_joint",
            "fr_caster_wheel_joint",
            "bl_caster_rotation_joint",
        ];
        check(&mir, &["left_wheel_joint"], &["right_wheel_joint"]);
        let ackermann = [
            "front_left_steer_joint",
            "front_right_steer_joint",
            "front_left_wheel",
            "front_right_wheel",
            "rear_left_wheel",
            "rear_right_wheel",
        ];
        check(
            &ackermann,
            &ackermann[2..].iter().copied().step_by(2).collect::<Vec<_>>(),
            &["front_right_wheel", "rear_right_wheel"],
        );
        let youbot = [
            "arm_joint_1",
            "wheel_joint_fl",
            "wheel_joint_fr",
            "wheel_joint_bl",
            "wheel_joint_br",
            "gripper_finger_joint_l",
            "gripper_finger_joint_r",
        ];
        check(
            &youbot,
            &["wheel_joint_bl", "wheel_joint_fl"],
            &["wheel_joint_br", "wheel_joint_fr"],
        );
        let hsr = ["base_l_drive_wheel_joint", "base_r_drive_wheel_joint", "base_roll_joint"];
        check(&hsr, &hsr[..1], &hsr[1..2]);
        check(&["LeftWheel", "rightWheel", "steeringWheel"], &["LeftWheel"], &["rightWheel"]);
        check(&["lwheel", "rwheel", "larm_1"], &["lwheel"], &["rwheel"]);
        let motors = ["motor_left", "motor_right", "left_probe", "right_probe"];
        check(&motors, &motors[..1], &motors[1..2]);
        check(&["left", "right", "left_arm_1"], &["left"], &["right"]);
        check(
            &["bright_left_wheel", "bright_right_wheel"],
            &["bright_left_wheel"],
            &["bright_right_wheel"],
        );
    }

    #[test]
    fn other_joints_and_unequal_sides_are_refused() {
        for names in [
            &["gripper_left_finger_joint", "gripper_right_finger_joint"][..],
            &["arm_left_1_joint", "arm_right_1_joint"],
            &["fl_caster_l_wheel_joint", "fl_caster_r_wheel_joint"],
            &["front_left_steering_wheel", "front_right_steering_wheel"],
            &["wheel_front", "wheel_back"],
            &[],
        ] {
            assert_eq!(find(names), Err(JointFault::None), "{names:?}");
        }
        let three = ["front_left_wheel", "rear_left_wheel", "rear_right_wheel"];
        assert_eq!(find(&three), Err(JointFault::Unequal { n_left: 2, n_right: 1 }));
        // A joint that is only named by its side is never used as a wheel.
        assert_eq!(
            find(&["left_wheel", "right"]),
            Err(JointFault::Unequal { n_left: 1, n_right: 0 })
        );
    }

    #[test]
    fn the_options_name_the_wheels() {
        let names: Vec<String> = ["a", "b", "c", "left_wheel"].map(str::to_owned).into();
        let options = |left: &[&str], right: &[&str]| WheelsTopic {
            topic: "/joints".to_owned(),
            left: left.iter().map(|&s| s.to_owned()).collect(),
            right: right.iter().map(|&s| s.to_owned()).collect(),
        };
        let found = WheelJoints::find(&names, &options(&["c"], &["a", "b"])).unwrap();
        assert_eq!((found.left, found.right), (vec![2], vec![0, 1]));
        assert_eq!(WheelJoints::find(&names, &options(&["c"], &["d"])), Err(JointFault::None));
    }
}
