//! Writes the seeds of every target, which are small valid inputs, to `corpus/`.

use std::fs;
use std::path::Path;

use loopboost_fuzz::{logs, samples};
use messages::Encoding;

fn main() -> std::io::Result<()> {
    let mut seeds = vec![
        ("packets", "packet".to_owned(), samples::packet(0).to_vec()),
        ("packets", "dual".to_owned(), samples::dual_packet().to_vec()),
    ];
    for (target, encoding) in [
        ("cdr", Encoding::Cdr),
        ("ros1", Encoding::Ros1),
        ("foxglove", Encoding::Protobuf),
        ("foxglove", Encoding::Json),
    ] {
        for (message_type, bytes) in samples::all(encoding) {
            let name = format!("{encoding}-{message_type}");
            if name.contains("Velodyne") {
                seeds.push(("packets", name.clone(), bytes.clone()));
            }
            seeds.push((target, name, bytes));
        }
    }
    for (name, bytes) in logs::seeds() {
        seeds.push(("log", name, bytes));
    }
    for (target, name, bytes) in seeds {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
        fs::create_dir_all(&folder)?;
        fs::write(folder.join(name), bytes)?;
    }
    Ok(())
}
