//! Paths that mean the same on every machine.

use std::path::{Component, Path, PathBuf};

use anyhow::{Context, Result, anyhow};

/// The path without links and without `.` and `..`. It must exist.
pub(super) fn canonical(path: &Path) -> Result<PathBuf> {
    let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    path.canonicalize().with_context(|| format!("cannot find {}", path.display()))
}

/// The path of a file whose folder is canonical. The file itself may be a link, whose name is kept, and need not exist.
pub(super) fn canonical_file(path: &Path) -> Result<PathBuf> {
    let name = path.file_name().ok_or_else(|| anyhow!("{} is not a file", path.display()))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    match canonical(folder) {
        Ok(folder) => Ok(folder.join(name)),
        Err(_) if !folder.exists() => Ok(std::path::absolute(path)?),
        Err(error) => Err(error),
    }
}

/// The path of `to` from the folder `from`, both canonical.
pub(super) fn relative(from: &Path, to: &Path) -> Result<String> {
    let shared = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    let up = from.components().skip(shared).map(|_| Component::ParentDir);
    let parts: Vec<Component<'_>> = up.chain(to.components().skip(shared)).collect();
    let text = |part: &Component<'_>| {
        part.as_os_str()
            .to_str()
            .map(str::to_owned)
            .ok_or_else(|| anyhow!("{} is not UTF-8; rename the file or the folder", to.display()))
    };
    let parts = parts.iter().map(text).collect::<Result<Vec<_>>>()?;
    Ok(if parts.is_empty() { ".".to_owned() } else { parts.join("/") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_relative_path_leads_from_one_folder_to_the_other() {
        let of = |from: &str, to: &str| relative(Path::new(from), Path::new(to)).unwrap();
        assert_eq!(of("/a/b", "/a/b/c/d.mcap"), "c/d.mcap");
        assert_eq!(of("/a/b", "/a/c/d.mcap"), "../c/d.mcap");
        assert_eq!(of("/a/b", "/x"), "../../x");
        assert_eq!(of("/a/b", "/a/b"), ".");
    }
}
