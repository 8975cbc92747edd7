//! Thin, graph, and two RGB pictures to two graphs: drawn rods at two sizes, every instruction set.

mod drawn;
mod stages;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use pickcell::level::Level;
use pickcell::vision::thin::Algorithm;
use stages::{Eye, SecondCore, Waits};
use std::hint::black_box;

const PICTURES: [(usize, usize, usize); 4] =
    [(640, 480, 20), (640, 480, 60), (1920, 1080, 20), (1920, 1080, 100)];

fn name((width, height, rods): (usize, usize, usize)) -> String {
    format!("{width}x{height}, {rods} rods")
}

fn thin(c: &mut Criterion) {
    let mut group = c.benchmark_group("thin");
    for picture @ (width, height, rods) in PICTURES {
        let [frame, _] = drawn::pair(width, height, rods, 1);
        for algorithm in [Algorithm::ZhangSuen, Algorithm::GuoHall] {
            for &level in Level::available() {
                let mut eye = Eye::new(width, height, algorithm, level);
                eye.binarize(&frame);
                let id = BenchmarkId::new(format!("{algorithm:?}/{}", level.name()), name(picture));
                group.bench_function(id, |b| {
                    b.iter(|| {
                        eye.thin();
                        black_box(eye.skeleton.words()[0])
                    })
                });
            }
        }
    }
}

fn graph(c: &mut Criterion) {
    let mut group = c.benchmark_group("graph");
    for picture @ (width, height, rods) in PICTURES {
        let [frame, _] = drawn::pair(width, height, rods, 1);
        for &level in Level::available() {
            let mut eye = Eye::new(width, height, Algorithm::ZhangSuen, level);
            eye.run(&frame);
            group.bench_function(BenchmarkId::new(level.name(), name(picture)), |b| {
                b.iter(|| {
                    eye.graph(&frame);
                    black_box(eye.graph.nodes.len())
                })
            });
        }
    }
}

fn pair_to_graphs(c: &mut Criterion) {
    let mut group = c.benchmark_group("pair to graphs");
    for picture @ (width, height, rods) in PICTURES {
        let [left, right] = drawn::pair(width, height, rods, 1);
        for &level in Level::available() {
            let mut eyes = [0; 2].map(|_| Eye::new(width, height, Algorithm::ZhangSuen, level));
            group.bench_function(
                BenchmarkId::new(format!("one core/{}", level.name()), name(picture)),
                |b| {
                    b.iter(|| {
                        eyes[0].run(&left);
                        eyes[1].run(&right);
                        black_box(eyes[0].graph.nodes.len() + eyes[1].graph.nodes.len())
                    })
                },
            );
            let [mut here, there] = eyes;
            let mut second = SecondCore::new(Waits::Asleep, there, right.clone());
            group.bench_function(
                BenchmarkId::new(format!("two cores/{}", level.name()), name(picture)),
                |b| {
                    b.iter(|| {
                        second.run(&mut here, &left);
                        black_box(here.graph.nodes.len())
                    })
                },
            );
        }
    }
}

criterion_group!(benches, thin, graph, pair_to_graphs);
criterion_main!(benches);
