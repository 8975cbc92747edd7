//! `make install` and `make uninstall` into a folder, with programs that only stand for the real ones.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A copy of what the scripts use, and where they install to.
struct Project {
    folder: tempfile::TempDir,
}

impl Project {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let project = Path::new(env!("CARGO_MANIFEST_DIR"));
        let parts = ["deploy", "docs", "replay", "cell.toml"].map(|name| project.join(name));
        let copied = Command::new("cp").arg("-R").args(parts).arg(folder.path()).status().unwrap();
        assert!(copied.success());
        Self { folder }
    }

    fn build(&self) {
        for name in ["pickcell", "firmware-bridge"] {
            let path = self.folder.path().join("target/release").join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, "#!/bin/sh\n").unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        }
    }

    fn run(&self, script: &str) -> Output {
        let script = self.folder.path().join("deploy").join(script);
        Command::new(script)
            .env("DESTDIR", self.at(""))
            .env("PREFIX", "/opt/cell")
            .env_remove("CARGO_TARGET_DIR")
            .output()
            .unwrap()
    }

    fn at(&self, path: &str) -> PathBuf {
        self.folder.path().join("root").join(path)
    }

    /// All files, without those of the recorded session.
    fn files(&self) -> Vec<String> {
        let listed =
            Command::new("find").arg(self.at("")).args(["-type", "f", "-printf", "%P\n"]).output().unwrap();
        let listed = String::from_utf8(listed.stdout).unwrap();
        let mut files: Vec<_> =
            listed.lines().filter(|f| !f.contains("/replay/")).map(str::to_owned).collect();
        files.sort();
        files
    }
}

#[test]
fn what_is_installed_is_whole_and_uninstalled_again_but_for_the_cell() {
    let project = Project::new();
    let missing = project.run("install.sh");
    assert_eq!(missing.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&missing.stderr).contains("run make build first"));
    project.build();
    assert!(project.run("install.sh").status.success());
    let files: Vec<_> = project.files().into_iter().filter(|file| !file.ends_with("backoff.conf")).collect();
    assert_eq!(
        files,
        [
            "etc/pickcell/cell.toml",
            "etc/security/limits.d/pickcell.conf",
            "etc/systemd/system/pickcell-bridge.service",
            "etc/systemd/system/pickcell.service",
            "etc/udev/rules.d/60-pickcell.rules",
            "opt/cell/bin/firmware-bridge",
            "opt/cell/bin/pickcell",
            "opt/cell/share/doc/pickcell/deploy.md",
        ]
    );
    let cell = fs::read_to_string(project.at("etc/pickcell/cell.toml")).unwrap();
    assert!(cell.contains("session = \"/opt/cell/share/pickcell/replay/conveyor\""));
    assert!(project.at("opt/cell/share/pickcell/replay/conveyor/calibration.yaml").is_file());
    // A cell of one's own and a drop-in of one's own outlive an update and the end.
    fs::write(project.at("etc/pickcell/cell.toml"), "# mine").unwrap();
    let own = "etc/systemd/system/pickcell.service.d/own.conf";
    fs::create_dir_all(project.at(own).parent().unwrap()).unwrap();
    fs::write(project.at(own), "[Service]\n").unwrap();
    assert!(project.run("install.sh").status.success());
    let gone = project.run("uninstall.sh");
    assert!(gone.status.success(), "{gone:?}");
    assert!(String::from_utf8_lossy(&gone.stdout).contains("etc/pickcell stays"));
    assert_eq!(project.files(), ["etc/pickcell/cell.toml", own]);
    assert!(!project.at("opt/cell/share/pickcell").exists());
    assert_eq!(fs::read_to_string(project.at("etc/pickcell/cell.toml")).unwrap(), "# mine");
    assert!(project.run("uninstall.sh").status.success(), "twice does no harm");
}

#[test]
fn systemd_finds_nothing_wrong_with_the_units() {
    if Command::new("systemd-analyze").arg("--version").output().is_err() {
        eprintln!("systemd-analyze is not here: the units are not verified");
        return;
    }
    let project = Project::new();
    project.build();
    assert!(project.run("install.sh").status.success());
    for unit in ["pickcell.service", "pickcell-bridge.service"] {
        // The programs are looked for where the unit says that they are.
        let path = project.at("etc/systemd/system").join(unit);
        let text = fs::read_to_string(&path).unwrap();
        let root = project.at("opt/cell/bin/").display().to_string();
        fs::write(&path, text.replace("/opt/cell/bin/", &root)).unwrap();
        let verified = Command::new("systemd-analyze").arg("verify").arg(&path).output().unwrap();
        let said = String::from_utf8_lossy(&verified.stderr).into_owned();
        assert!(verified.status.success() && said.is_empty(), "{unit}: {said}");
    }
}
