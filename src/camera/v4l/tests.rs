use super::*;
use crate::frame::PixelFormat;
use std::collections::BTreeMap;

pub(super) fn settings(device: &str) -> CameraSettings {
    CameraSettings {
        device: device.into(),
        format: PixelFormat::Yuyv,
        width: 640,
        height: 480,
        rate_hz: 30.0,
        matrix: None,
        range: None,
        controls: BTreeMap::new(),
    }
}

fn complaint(device: &str) -> String {
    V4lCamera::open(settings(device)).expect_err("no camera").to_string()
}

#[test]
fn what_is_not_there_or_no_camera_is_told() {
    assert_eq!(
        complaint("/dev/v4l/by-path/none"),
        "camera /dev/v4l/by-path/none: there is no such device; plug it in, or take its path from `pickcell \
         devices`"
    );
    assert_eq!(
        complaint("/dev/null"),
        "/dev/null is not a camera: it is no V4L2 device; take the path of one from `pickcell devices`"
    );
}

#[test]
fn a_camera_that_comes_late_is_waited_for_and_no_other() {
    let folder = std::env::temp_dir().join(format!("pickcell-late-camera-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let link = folder.join("camera");
    let late = link.clone();
    let plugs_in = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(250));
        std::os::unix::fs::symlink("/dev/null", late).expect("a link");
    });
    let asked = settings(&link.to_string_lossy());
    let fault = V4lCamera::open_within(asked.clone(), Duration::from_secs(60)).expect_err("no camera");
    plugs_in.join().expect("plugged in");
    assert!(matches!(fault, CameraError::NotACamera { .. }), "{fault}");
    std::fs::remove_dir_all(&folder).expect("removed");
    let fault = V4lCamera::open_within(asked, Duration::from_millis(150)).expect_err("no camera");
    assert!(matches!(fault, CameraError::Absent { .. }), "{fault}");
}

#[test]
fn a_camera_that_never_came_is_lost_once_and_looked_for() {
    let mut camera = V4lCamera::closed(settings("/dev/v4l/by-path/none"));
    assert_eq!(camera.frame_bytes_max(), 640 * 480 * 3);
    let mut grab = || camera.grab(&mut Frame::default(), Duration::from_millis(1));
    assert_eq!(grab(), Grab::Lost(Trouble::Unplugged));
    for _ in 0..200 {
        assert_eq!(grab(), Grab::TimedOut);
    }
}

#[test]
fn a_lost_camera_in_whose_place_another_device_comes_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let link = folder.path().join("camera");
    let mut camera = V4lCamera::closed(settings(&link.to_string_lossy()));
    let mut grab = || camera.grab(&mut Frame::default(), Duration::from_secs(60));
    assert_eq!(grab(), Grab::Lost(Trouble::Unplugged));
    std::os::unix::fs::symlink("/dev/null", link).expect("a link");
    let news: Vec<Grab> = (0..4).map(|_| grab()).filter(|&grab| grab != Grab::TimedOut).collect();
    assert_eq!(news, [Grab::Lost(Trouble::NotAsAsked)]);
}

#[test]
fn a_stamp_is_the_drivers_where_its_clock_is_known() {
    let (began, now) = (Timestamp(5_000_000_000), Timestamp(50_000_000_000));
    let sleep = never_slept();
    let stamp = |at, start| stamp(&Filled::stamped(at, start), &sleep, began, now);
    let of_dequeue = (now, TimestampMark::HandedOver);
    assert_eq!(
        stamp(Some(49_980_000_000), true),
        (Timestamp(49_980_000_000), TimestampMark::StartOfExposure)
    );
    assert_eq!(stamp(Some(50_010_000_000), false).1, TimestampMark::EndOfFrame);
    assert_eq!(stamp(None, false), of_dequeue);
    assert_eq!(stamp(Some(-6_000_000_000), false), of_dequeue);
    assert_eq!(stamp(Some(61_000_000_000), false), of_dequeue);
}

#[test]
fn a_frame_that_waited_while_the_process_stood_still_stays_old() {
    let (began, now) = (Timestamp(5_000_000_000), Timestamp(500_000_000_000));
    let waited = Filled::stamped(Some(6_000_000_000), false);
    assert_eq!(
        stamp(&waited, &never_slept(), began, now),
        (Timestamp(6_000_000_000), TimestampMark::EndOfFrame)
    );
}

#[test]
fn a_stamp_of_a_machine_that_was_suspended_is_on_the_cells_clock() {
    let sleep =
        Sleep::until_now(|| Clocks { cell: Timestamp(3_605_000_000_000), monotonic_ns: 5_000_000_000 });
    let (began, now) = (Timestamp(3_604_000_000_000), Timestamp(3_605_000_000_000));
    let filled = Filled::stamped(Some(4_980_000_000), false);
    assert_eq!(stamp(&filled, &sleep, began, now), (Timestamp(3_604_980_000_000), TimestampMark::EndOfFrame));
}

fn never_slept() -> Sleep {
    Sleep::until_now(|| Clocks { cell: Timestamp(0), monotonic_ns: 0 })
}
