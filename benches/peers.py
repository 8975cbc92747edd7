#!/usr/bin/env python3
"""Other people's code on the pictures that `cargo bench --bench table` writes: one JSON line a figure.

Usage: peers.py FOLDER PICTURE...
Takes OpenCV, scikit-image, skan and sknw where they are installed, one thread, median of several runs. Processor
time, not time on the wall: runs this long are interrupted by whatever else the machine does, and that shall not count
against them.
"""
import json
import os
import statistics
import sys
import time

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"


def module(name):
    try:
        return __import__(name, fromlist=["_"])
    except ImportError:
        print(f"without {name}: not installed", file=sys.stderr)
        return None


def median_us(work, seconds=0.6):
    work()
    times, begin = [], time.perf_counter()
    while len(times) < 5 or (time.perf_counter() - begin < seconds and len(times) < 301):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return statistics.median(times) * 1e6


def figure(job, who, picture, work):
    line = {"job": job, "who": who, "picture": picture, "median_us": median_us(work)}
    print(json.dumps(line), flush=True)


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    folder, pictures = sys.argv[1], sys.argv[2:]
    cv2, np = module("cv2"), module("numpy")
    morphology = module("skimage.morphology")
    skan, sknw = module("skan"), module("sknw")
    if cv2 is None or np is None:
        return
    cv2.setNumThreads(1)
    for picture in pictures:
        rgb = cv2.imread(os.path.join(folder, f"{picture}-rgb.png"))
        mask = cv2.imread(os.path.join(folder, f"{picture}-mask.png"), cv2.IMREAD_GRAYSCALE)
        skeleton = cv2.imread(os.path.join(folder, f"{picture}-skeleton.png"), cv2.IMREAD_GRAYSCALE)
        if rgb is None or mask is None or skeleton is None:
            print(f"{folder}: no picture {picture}", file=sys.stderr)
            continue
        out = np.empty_like(mask)
        low, high = (100, 100, 100), (255, 255, 255)
        figure("RGB to bits", "OpenCV inRange", picture, lambda: cv2.inRange(rgb, low, high, out))
        if hasattr(cv2, "ximgproc"):
            for job, kind in (
                ("thin, Zhang-Suen", cv2.ximgproc.THINNING_ZHANGSUEN),
                ("thin, Guo-Hall", cv2.ximgproc.THINNING_GUOHALL),
            ):
                figure(job, "OpenCV", picture, lambda: cv2.ximgproc.thinning(mask, thinningType=kind))
        if morphology is not None:
            binary = mask > 0
            figure("thin, Zhang-Suen", "scikit-image", picture, lambda: morphology.skeletonize(binary, method="zhang"))
        if skan is not None:
            figure("skeleton to graph", "skan", picture, lambda: skan.Skeleton(skeleton > 0))
        if sknw is not None:
            figure("skeleton to graph", "sknw", picture, lambda: sknw.build_sknw(skeleton > 0))


if __name__ == "__main__":
    main()
