//! Thinning against OpenCV's skeletons of the pictures in tests/thinning, and of more where ../shared/thinning is there.

use pickcell::level::Level;
use pickcell::vision::bits::BitImage;
use pickcell::vision::thin::{Algorithm, Params, Thin};
use std::path::Path;

fn read(path: &Path) -> BitImage {
    let grey = image::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).into_luma8();
    BitImage::from_grey(grey.width() as usize, grey.height() as usize, grey.as_raw())
}

/// Every picture of these names in a folder of the project, with both algorithms and all instructions.
fn check(folder: &str, names: &[&str]) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    for name in names {
        let mask = read(&folder.join(format!("{name}.png")));
        for (algorithm, suffix) in
            [(Algorithm::ZhangSuen, "cv_zhangsuen"), (Algorithm::GuoHall, "cv_guohall")]
        {
            let expected = read(&folder.join(format!("{name}__{suffix}.png")));
            for &level in Level::available() {
                let mut skeleton = BitImage::new(mask.width(), mask.height());
                Thin::with_level(Params { algorithm }, mask.width(), mask.height(), level)
                    .run(&mask, &mut skeleton);
                assert!(skeleton == expected, "{name}, {algorithm:?}, {level:?}");
            }
        }
    }
}

#[test]
fn skeletons_equal_opencv_pixel_for_pixel() {
    check("tests/thinning", &["drawn", "skimage_horse"]);
}

#[test]
fn skeletons_of_the_shared_pictures_equal_opencv_pixel_for_pixel() {
    if !Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/thinning").is_dir() {
        println!("skipped: ../shared/thinning is not there");
        return;
    }
    check("../shared/thinning", &["opencv_shape_3", "opencv_shape_14"]);
}
