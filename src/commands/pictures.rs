//! Which pictures make pairs, and how they are read from files.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use super::recognize::RecognizeError;
use crate::frame::{Frame, FramePair};
use crate::rig::{CameraModel, Rig};
use crate::session::{RecordedPicture, Session, is_picture};
use crate::vision::decode::{Decoder, Output};

/// Two pictures that belong together: one for each side, unless a picture is missing or it is in doubt which it is.
#[derive(Clone, Debug)]
pub struct PairFiles {
    /// The folder's name, the files' name without ending, or a recording's name of the pair.
    pub name: String,
    /// Where to look, for the message about a missing picture.
    pub folder: PathBuf,
    /// Left and right.
    pub files: [Vec<RecordedPicture>; 2],
}

const SIDES: [&str; 2] = ["left", "right"];

/// The pairs of a recording in their order, or of a folder in order of name: the pictures of equal name of `left/` and `right/` where it has both, else
/// every folder in it that holds a `left` or a `right` picture.
///
/// # Errors
/// The recording cannot be read, the folder cannot be listed, or there is no pair in it.
pub fn pairs_of(folder: &Path) -> Result<Vec<PairFiles>, RecognizeError> {
    if folder.is_file() {
        return recorded_pairs(folder);
    }
    let is_session = SIDES.iter().all(|side| folder.join(side).is_dir());
    let pairs = if is_session { session_pairs(folder)? } else { folder_pairs(folder)? };
    if !pairs.iter().any(|p| p.files.iter().all(|files| !files.is_empty())) {
        return Err(RecognizeError::NoPairs { path: folder.to_owned() });
    }
    Ok(pairs)
}

fn recorded_pairs(path: &Path) -> Result<Vec<PairFiles>, RecognizeError> {
    let session = Session::open(path)?;
    if let Some(note) = session.break_note() {
        tracing::warn!("{note}");
    }
    let pair = |pair: crate::session::RecordedPair| PairFiles {
        name: pair.name,
        folder: path.to_owned(),
        files: pair.pictures.map(Vec::from_iter),
    };
    // Lone pictures are recorded to be played as what they are.
    Ok(session.pairs.into_iter().filter(crate::session::RecordedPair::is_whole).map(pair).collect())
}

fn session_pairs(folder: &Path) -> Result<Vec<PairFiles>, RecognizeError> {
    let mut names: BTreeMap<String, [Vec<RecordedPicture>; 2]> = BTreeMap::new();
    for (i, side) in SIDES.iter().enumerate() {
        for path in entries(&folder.join(side))? {
            if let (true, Some(stem)) = (is_picture(&path), path.file_stem()) {
                let files = names.entry(stem.to_string_lossy().into_owned()).or_default();
                files[i].push(RecordedPicture::File(path));
            }
        }
    }
    Ok(names.into_iter().map(|(name, files)| PairFiles { name, folder: folder.to_owned(), files }).collect())
}

fn folder_pairs(folder: &Path) -> Result<Vec<PairFiles>, RecognizeError> {
    let mut pairs = Vec::new();
    for path in entries(folder)? {
        if !path.is_dir() {
            continue;
        }
        // what cannot be listed is no pair
        let pictures: Vec<PathBuf> = entries(&path).unwrap_or_default();
        let files = SIDES.map(|side| {
            let of_side = |p: &&PathBuf| p.file_stem() == Some(OsStr::new(side)) && is_picture(p);
            pictures.iter().filter(of_side).cloned().map(RecordedPicture::File).collect()
        });
        if files.iter().any(|files: &Vec<_>| !files.is_empty()) {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            pairs.push(PairFiles { name, folder: path, files });
        }
    }
    Ok(pairs)
}

/// What a folder holds, in order of name.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, RecognizeError> {
    let failed = |source| RecognizeError::Folder { path: folder.to_owned(), source };
    let list = fs::read_dir(folder).map_err(failed)?;
    let mut paths = list.map(|e| e.map(|e| e.path())).collect::<Result<Vec<_>, _>>().map_err(failed)?;
    paths.sort();
    Ok(paths)
}

/// Reads both pictures of a pair and checks their sizes. A JPEG stays compressed, as a camera would send it.
///
/// # Errors
/// A picture is missing, there are two for one side, one cannot be read, or has not the calibration's size.
pub fn read_pair(pair: &PairFiles, rig: &Rig) -> Result<(FramePair, [PathBuf; 2]), RecognizeError> {
    let picture = |side: usize| {
        let name = SIDES[side];
        match &pair.files[side][..] {
            [] => Err(RecognizeError::MissingPicture { path: pair.folder.join(name), side: name }),
            [picture] => Ok(picture),
            [first, other, ..] => {
                Err(RecognizeError::TwoPictures { path: first.place(), other: other.place(), side: name })
            }
        }
    };
    let pictures = [picture(0)?, picture(1)?];
    let read = |picture: &RecordedPicture, side: &'static str, camera: &CameraModel| {
        if let RecordedPicture::File(path) = picture
            && fs::metadata(path).is_ok_and(|m| !m.is_file())
        {
            return Err(RecognizeError::NoFile { path: path.clone() });
        }
        let frame = picture.read()?;
        camera
            .check_size(side, frame.width, frame.height)
            .map_err(|reason| RecognizeError::Size { path: picture.place(), reason })?;
        Ok(frame)
    };
    let [left, right] = pictures;
    let frames = FramePair { left: read(left, "left", &rig.left)?, right: read(right, "right", &rig.right)? };
    Ok((frames, pictures.map(RecordedPicture::place)))
}

/// The picture without compression; a JPEG becomes what `output` says.
///
/// # Errors
/// A JPEG that is damaged, cut short, or of colours that do not become that.
pub fn decoded(frame: &Frame, path: &Path, output: Output) -> Result<Frame, RecognizeError> {
    let mut decoder = Decoder::new(output, frame.width, frame.height);
    let raw = decoder.run(frame);
    raw.cloned().map_err(|reason| RecognizeError::Decode { path: path.to_owned(), reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn touch(path: PathBuf) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, b"x").unwrap();
    }

    fn places(pair: &PairFiles) -> [Vec<PathBuf>; 2] {
        pair.files.each_ref().map(|files| files.iter().map(RecordedPicture::place).collect())
    }

    #[test]
    fn folders_of_pairs_are_listed_in_order_of_name() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in
            ["b/left.png", "b/right.JPG", "a/left.jpg", "a/right.jpg", "c/left.png", "d/truth.json", "e.png"]
        {
            touch(at(name));
        }
        let pairs = pairs_of(folder.path()).unwrap();
        let names: Vec<_> = pairs.iter().map(|p| p.name.as_str()).collect();
        assert_eq!(names, ["a", "b", "c"]);
        assert_eq!(places(&pairs[1]), [[at("b/left.png")], [at("b/right.JPG")]]);
        assert!(pairs[2].files[1].is_empty());
    }

    #[test]
    fn a_session_is_listed_by_equal_names() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in
            ["left/1.jpg", "left/2.png", "right/1.jpg", "right/2.jpg", "left/notes.txt", "session.toml"]
        {
            touch(at(name));
        }
        let pairs = pairs_of(folder.path()).unwrap();
        assert_eq!(pairs.len(), 2);
        assert_eq!(places(&pairs[1]), [[at("left/2.png")], [at("right/2.jpg")]]);
    }

    #[test]
    fn two_pictures_for_one_side_of_a_pair_are_refused() {
        let rig = Rig::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/conveyor/calibration.yaml"))
            .unwrap();
        for names in
            [["a/left.jpg", "a/left.png", "a/right.jpg"], ["left/1.jpg", "left/1.png", "right/1.jpg"]]
        {
            let folder = tempfile::tempdir().unwrap();
            names.iter().for_each(|name| touch(folder.path().join(name)));
            let pairs = pairs_of(folder.path()).unwrap();
            let message = read_pair(&pairs[0], &rig).unwrap_err().to_string();
            assert!(message.contains(names[0]) && message.contains(names[1]), "{message}");
            assert!(message.contains("both for the left picture of this pair"), "{message}");
        }
    }

    #[test]
    fn what_holds_no_pair_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let message = |path: &Path| pairs_of(path).unwrap_err().to_string();
        assert!(message(folder.path()).contains("no pair in it; it must hold folders with left.png|jpg"));
        assert!(message(&folder.path().join("absent")).contains("absent: cannot read it: No such file"));
    }
}
