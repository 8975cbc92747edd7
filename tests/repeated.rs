//! A recognition that ran out of time finds the same when it is made once more with what it used up.

use std::path::Path;
use std::time::Duration;

use nalgebra::Vector3;
use pickcell::frame::FramePair;
use pickcell::part::Part;
use pickcell::recognize::{Params, Recognition, Recognizer, StageTimes};
use pickcell::rig::Rig;
use pickcell::session::Session;
use pickcell::time::{Budget, Timestamp};

#[test]
fn a_repetition_finds_what_was_found_when_time_was_over() {
    let replay = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay");
    let rig = Rig::read(replay.join("conveyor/calibration.yaml")).unwrap();
    let rod = Part::read(replay.join("parts/rod-90.toml")).unwrap();
    let recognizer = |rig| Recognizer::new(Params::default(), rig, vec![rod.clone()]).unwrap();
    // A camera that has turned by half a pixel is allowed for in a second go.
    let turned = rig.with_right_turned(&Vector3::new(0.5 / rig.right.fy, 0.0, 0.0));
    let mut recognizers = [recognizer(rig), recognizer(turned)];
    let session = Session::open(&replay.join("conveyor")).unwrap();
    let (mut stopped, mut turned) = ([0; 2], 0);
    for (recorded, recognizer) in session.pairs[..4].iter().flat_map(|pair| [(pair, 0), (pair, 1)]) {
        let recognizer = &mut recognizers[recognizer];
        let [Some(left), Some(right)] = &recorded.pictures else { panic!("a whole pair") };
        let pair = FramePair { left: left.read().unwrap(), right: right.read().unwrap() };
        let mut found = Recognition::default();
        let mut total_ns = || {
            recognizer.run(&pair, Budget::Iterations(1_000_000), 1, &mut found).unwrap();
            found.stages.total_ns
        };
        // The first time takes longer, and a busy machine may take longer any time.
        let whole = Duration::from_nanos((0..3).map(|_| total_ns()).min().unwrap());
        for share in 0..45 {
            let until = Timestamp::now().after(whole * share / 30);
            recognizer.run(&pair, Budget::Until(until), 1, &mut found).unwrap();
            stopped[0] += usize::from(found.spent.looks.is_some());
            stopped[1] += usize::from(found.spent.late);
            turned +=
                usize::from(found.turned.is_some_and(|turned| turned.is_allowed_for()) && found.out_of_time);
            let mut again = Recognition::default();
            recognizer.run(&pair, Budget::Repeated(found.spent), 1, &mut again).unwrap();
            let without_times = |r: &Recognition| Recognition { stages: StageTimes::default(), ..r.clone() };
            assert_eq!(without_times(&again), without_times(&found), "{} {share}/30", recorded.name);
        }
    }
    println!("stopped {stopped:?}, after a turn {turned}");
    assert!(stopped[0] > stopped[1] && stopped[1] > 0 && turned > 0, "{stopped:?} {turned}");
}
