//! Parts of the sentences of [notes](crate::Note).

/// A number of things: `1 scan`, `2 scans`.
pub(crate) fn count(n: u64, thing: &str) -> String {
    format!("{n} {thing}{}", if n == 1 { "" } else { "s" })
}

/// How often something happens: `once`, `2 times`.
pub(crate) fn times(n: u64) -> String {
    match n {
        1 => "once".to_owned(),
        n => format!("{n} times"),
    }
}

/// What happens to the poses after a jump, as the end of a sentence.
pub(crate) fn after_jumps(same_frame: bool) -> &'static str {
    match same_frame {
        true => "",
        false => {
            ", and poses before and after it give no pairs together; if both are in one map, set `ingest.pose.jumps = \"same_frame\"`"
        }
    }
}
