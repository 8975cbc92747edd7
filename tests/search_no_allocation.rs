//! After `new` no search allocates, whatever its method and gate.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use pickcell::matching::drawn::DrawnScene;
use pickcell::matching::gate::{GateParams, Mode};
use pickcell::matching::search::{Method, Params, Search};
use pickcell::time::Budget;

/// Counts the allocations of each thread.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call goes to the system's allocator unchanged; counting neither allocates nor unwinds.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        // SAFETY: the caller's promises are the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are the same.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        // SAFETY: the caller's promises are the same.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

#[test]
fn no_search_allocates_after_new() {
    let scenes = [DrawnScene::new(2, 8, 1), DrawnScene::new(4, 6, 2), DrawnScene::new(8, 4, 3)];
    let counted = ALLOCATIONS.with(Cell::get);
    assert!(counted > 0, "the counter counts");
    for method in [
        Method::Auto,
        Method::Harmony,
        Method::Improved,
        Method::SelfAdaptive,
        Method::Random,
        Method::Exhaustive,
    ] {
        for mode in [Mode::Epipolar, Mode::None] {
            let params = Params { method, ..Params::default() };
            let mut search = Search::new(params, GateParams { mode, ..GateParams::default() }, 2);
            for scene in &scenes {
                let [left, right] = &scene.nodes;
                let before = ALLOCATIONS.with(Cell::get);
                let budget = Budget::Iterations(20_000);
                search.run(&scene.rig, left, right, [0.0, 1e9], |_| scene.judge(), budget, 1);
                let after = ALLOCATIONS.with(Cell::get);
                assert_eq!(after - before, 0, "{method:?}, gate {mode:?}");
                assert!(search.iterations() > 0);
            }
        }
    }
}
