//! Outputs that cannot be written are found before the work that makes them, not after it.

use super::{Exit, Failure};
use anyhow::anyhow;
use std::fs::OpenOptions;
use std::path::Path;

/// Refuses a file that could not be written. What is there stays as it is.
pub fn check_file(path: &Path) -> Result<(), Failure> {
    let refused = |why: &str, next: &str| {
        let error = anyhow!("{}: cannot be written ({why}); {next}", path.display());
        Err(Failure::new(Exit::Usage, error))
    };
    if path.is_dir() {
        return refused("it is a folder", "give the name of a file in it");
    }
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        let next = format!("make the folder {} first", folder.display());
        return refused("its folder does not exist", &next);
    }
    let is_new = !path.exists();
    let opened = OpenOptions::new()
        .append(true)
        .create_new(is_new)
        .open(path);
    if let Err(error) = opened {
        return refused(
            &error.to_string(),
            "choose another place or its permissions",
        );
    }
    if is_new {
        // Only the try made it.
        let _ = std::fs::remove_file(path);
    }
    Ok(())
}

/// Refuses a folder that could not be made or written to.
pub fn check_folder(path: &Path) -> Result<(), Failure> {
    if path.is_dir() {
        return check_file(&path.join(".palpus-try"));
    }
    if path.exists() {
        let error = anyhow!("{}: is a file; give a folder", path.display());
        return Err(Failure::new(Exit::Usage, error));
    }
    // The nearest folder above that is there has to take a new one.
    let above = path.ancestors().skip(1).find(|p| p.exists());
    let above = above.filter(|p| !p.as_os_str().is_empty());
    check_file(&above.unwrap_or(Path::new(".")).join(".palpus-try"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_can_be_written_is_left_alone_and_the_rest_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("old"), "text").unwrap();
        assert!(check_file(&at("new")).is_ok() && check_file(&at("old")).is_ok());
        assert_eq!(std::fs::read_to_string(at("old")).unwrap(), "text");
        assert!(!at("new").exists());
        assert!(check_folder(&at("a/b/c")).is_ok() && check_folder(folder.path()).is_ok());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        for (outcome, words) in [
            (check_file(&at("none/new")), "make the folder"),
            (check_file(folder.path()), "is a folder"),
            (check_file(&at("old/new")), "folder does not exist"),
            (check_folder(&at("old")), "is a file"),
            (check_folder(&at("old/new")), "folder does not exist"),
        ] {
            let said = outcome.unwrap_err().error.to_string();
            assert!(said.contains(words), "{said}");
        }
    }
}
