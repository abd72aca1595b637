//! Bags that the library `rosbags` writes have the messages of the log they were made from.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::require::python_with;
use crate::support::{Workplace, loopboost, root};

/// Topic, name of the type, log time and bytes of each message.
fn messages(log: &Path) -> Vec<(String, String, u64, Vec<u8>)> {
    let log = fs::read(log).unwrap();
    let messages = mcap::MessageStream::new(&log).unwrap().map(|message| {
        let message = message.unwrap();
        let schema = message.channel.schema.as_ref().unwrap();
        assert!(!schema.data.is_empty(), "{} has a definition", schema.name);
        (
            message.channel.topic.clone(),
            schema.name.clone(),
            message.log_time,
            message.data.to_vec(),
        )
    });
    let mut messages: Vec<_> = messages.collect();
    messages.sort();
    messages
}

#[test]
fn bags_of_ros_1_and_ros_2_give_the_messages_of_the_log_they_were_made_from() {
    let Some(python) = python_with(&["mcap", "rosbags"]) else { return };
    for (encoding, n_bags) in [("ros1", 3), ("ros2", 4)] {
        let simulated = format!(
            "seed = 7\n[simulate]\nlogs = [\"drive\"]\nlength_m = 12.0\npeople = 0\nencoding = \"{encoding}\"\n"
        );
        let workplace = Workplace::new(&simulated);
        workplace.command("simulate", "out", &[]).expect(0);
        let (log, bags) = (workplace.path("out/logs/drive.mcap"), workplace.path("bags"));
        let written = Command::new(&python)
            .arg("-B")
            .arg(root().join("tests/peers/bags.py"))
            .args([&log, &bags])
            .output()
            .unwrap();
        assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
        let expected = messages(&log);
        assert!(1000 < expected.len());
        let bags: Vec<PathBuf> =
            fs::read_dir(&bags).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert_eq!(bags.len(), n_bags);
        for bag in bags {
            let imported = bag.with_extension("imported.mcap");
            let args = [&bag, Path::new("--out"), &imported].map(|arg| arg.to_str().unwrap());
            loopboost(&[&["import"], &args[..]].concat()).expect(0);
            assert!(messages(&imported) == expected, "{} differs", bag.display());
        }
    }
}
