#!/usr/bin/env python3
"""Drives the test in the virtual machine: starts the simulated arm and the guest, brings scenes and faults, and compares
every grasp that the arm carried out with the truth of the picture that was in view. See run.sh."""

import argparse
import json
import math
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
VM = PROJECT / "../shared/v4l2-vm/v4l2-vm"
SCENES = PROJECT / "../shared/scenes/conveyor"

# A grasp may be this far from the part's axis, and from the middle of the part along it, in mm: 95 % of the
# recogniser's errors are smaller, and the pictures went through YUYV once more.
ACROSS_MM_MAX = 1.0
ALONG_MM_MAX = 2.5

# After each of these the cell has to pick the next scene's part rightly. Lines for cam.ctl; "wait:" waits for a word
# in the cell's log or lines, "sleep:" for seconds.
FAULTS = {
    "unplug": ["unplug 1", "wait:unplugged", "sleep:1", "plug 1"],
    "stall": ["stall 0", "wait:no frames", "resume 0"],
    "damaged": ["error 1 5"],
    "short": ["short 0 5"],
    "dropped": ["drop 1 5"],
    "dark": ["light 0.7"],
    "bright": ["light 1.3"],
}


def quaternion_to_rows(x, y, z, w):
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def base_from_left():
    for line in (PROJECT / "tests/vm/cell.toml").read_text().splitlines():
        if line.startswith("base_from_left"):
            numbers = [json.loads(part + "]") for part in (s[s.index("["):] for s in line.split("]")[:2])]
            return quaternion_to_rows(*numbers[1]), numbers[0]
    raise SystemExit("vm: no base_from_left in cell.toml")


ROWS, TRANSLATION_MM = base_from_left()


def to_base(point_mm):
    return [sum(r * p for r, p in zip(row, point_mm)) + t for row, t in zip(ROWS, TRANSLATION_MM)]


def distance_to_part(truth, grasp_mm):
    """(across, along) in mm from a part's grasp point, measured from its axis."""
    centre = to_base(truth["grasp"]["position_mm"])
    axis = [sum(r * a for r, a in zip(row, truth["grasp"]["axis"])) for row in ROWS]
    offset = [g - c for g, c in zip(grasp_mm, centre)]
    along = sum(o * a for o, a in zip(offset, axis))
    across = math.sqrt(max(0.0, sum(o * o for o in offset) - along * along))
    return across, abs(along)


class Arm:
    """`firmware-bridge simulate` on a pty; its motions come through a queue."""

    def __init__(self, folder):
        self.link = folder / "arm"
        self.motions = queue.Queue()
        self.process = subprocess.Popen(
            [PROJECT / "target/release/firmware-bridge", "--log", "warn", "simulate", "--pty", self.link,
             "--dialect", "own", "--format", "json", "--park-mm", "120", "240", "200"],
            stdout=subprocess.PIPE, text=True)
        threading.Thread(target=self.read, daemon=True).start()
        for _ in range(100):
            if self.link.exists():
                return
            time.sleep(0.05)
        raise SystemExit("vm: the simulated arm did not start")

    def read(self):
        for line in self.process.stdout:
            self.motions.put(json.loads(line))

    def next_grasp(self, seconds):
        """Where the fingers closed next, or None."""
        end = time.monotonic() + seconds
        at = None
        while time.monotonic() < end:
            try:
                motion = self.motions.get(timeout=0.2)
            except queue.Empty:
                continue
            if motion["motion"] == "arrived":
                at = motion["at_mm"]
            if motion["motion"] == "closed":
                return at
        return None


class Guest:
    def __init__(self, folder, arm, names, limit_s):
        self.out = folder / "out"
        job, frames = folder / "job", folder / "frames"
        job.mkdir()
        for program in [PROJECT / "target/release/pickcell"]:
            shutil.copy(program, job)
        for file in ["cell.toml", "guest.sh"]:
            shutil.copy(PROJECT / "tests/vm" / file, job)
        shutil.copy(SCENES / "calibration.yaml", job)
        shutil.copy(SCENES / "../parts/rod-90.toml", job)
        for side in ["left", "right"]:
            (frames / side).mkdir(parents=True)
            for name in names:
                shutil.copy(SCENES / side / f"{name}.png", frames / side)
        # Damaged and short frames are to arrive as such, not as gaps; MJPEG comes without Huffman tables.
        self.process = subprocess.Popen(
            [VM, "--uvc", "--uvc-args", "nodrop=1", "--sim-args", "--strip-dht", "--frames", frames,
             "--hold", "0", "--out", self.out,
             "--arm-tty", arm.link, "--timeout", str(limit_s), job, "--", "sh", "guest.sh"])

    def command(self, line):
        for _ in range(200):
            try:
                pipe = os.open(self.out / "cam.ctl", os.O_WRONLY | os.O_NONBLOCK)
                break
            except OSError:
                time.sleep(0.1)
        else:
            raise SystemExit("vm: the cameras cannot be steered")
        os.write(pipe, (line + "\n").encode())
        os.close(pipe)

    def said(self):
        text = ""
        for name in ["run.log", "run.jsonl"]:
            path = self.out / name
            text += path.read_text(errors="replace") if path.exists() else ""
        return text

    def wait_for(self, word, since, seconds=15):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.said().count(word) > since:
                return True
            time.sleep(0.2)
        return False

    def perform(self, steps):
        """Does the steps of a fault; gives what did not happen, or None."""
        for step in steps:
            kind, _, rest = step.partition(":")
            if kind == "sleep":
                time.sleep(float(rest))
            elif kind == "wait":
                if not self.wait_for(rest, self.marks.get(rest, 0)):
                    return f"the cell did not say {rest!r}"
                self.marks[rest] = self.said().count(rest)
            else:
                self.command(step)
        return None

    marks = {}

    def scenes_of_target(self, number):
        """The scenes that the pair of the so-manieth target can show: one, or two where the pictures changed just then.
        The log has the time of the target's last byte and how old the older frame was then."""
        lines = [line for line in (self.out / "run.log").read_text().splitlines() if "target on the wire" in line]
        values = dict(word.split("=") for word in lines[number].split() if "=" in word)
        frame_ns = (float(values["at_ms"]) - float(values["frame_to_wire_ms"])) * 1e6
        window_ns = 50e6
        shown = [line.split(",") for line in (self.out / "shown.csv").read_text().splitlines() if line[0].isdigit()]
        scenes = set()
        for camera in "01":
            for at_ns in (frame_ns, frame_ns + window_ns):
                names = [row[1] for row in shown if row[3] == camera and int(row[2]) <= at_ns]
                scenes.add(names[-1].removesuffix(".png"))
        return scenes

    def counts(self):
        """What the cell counted, from the summary that it prints at the end."""
        path = self.out / "run.jsonl"
        for line in reversed(path.read_text().splitlines() if path.exists() else []):
            if "summary" in line:
                return json.loads(line)["summary"]["counts"]
        return {}


def judge(name, grasp_mm):
    """What is wrong with a grasp of this scene, and how far it is off."""
    truth = json.loads((SCENES / "truth" / f"{name}.json").read_text())
    nearest = min(truth["objects"], key=lambda part: sum(distance_to_part(part, grasp_mm)))
    across, along = distance_to_part(nearest, grasp_mm)
    if across > ACROSS_MM_MAX or along > ALONG_MM_MAX:
        return f"no part there: {across:.2f} mm across and {along:.2f} mm along from the nearest", across, along
    if nearest["occluded"]:
        return f"part {nearest['id']} lies under another", across, along
    return None, across, along


def guest_job(folder, name, script):
    """A folder for the guest: the cell, what it needs, and a script that is run there."""
    job = folder / f"job-{name}"
    job.mkdir()
    for file in [PROJECT / "target/release/pickcell", PROJECT / "tests/vm/cell.toml", PROJECT / "tests/vm" / script,
                 SCENES / "calibration.yaml", SCENES / "../parts/rod-90.toml"]:
        shutil.copy(file, job)
    return job


def check_formats(folder, kind, formats):
    """Opens the cameras of the test drivers in every format; gives what went wrong."""
    job, out = guest_job(folder, kind, "guest-formats.sh"), folder / f"out-{kind}"
    extra = ["--format", formats[0], "--fps", "25"] if kind == "loopback" else []
    subprocess.run([VM, f"--{kind}", *extra, "--out", out, job, "--", "sh", "guest-formats.sh", *formats])
    failed = []
    for code in formats:
        path = out / f"{code}.json"
        findings = json.loads(path.read_text())["findings"] if path.exists() else []
        for side in ["left", "right"]:
            seen = [f["finding"] for f in findings if f["subject"] == f"{side} camera"]
            good = [text for text in seen if "frames a second of" in text]
            print(f"{kind} {code}: {side} camera: {good[0] if good else 'FAILED: ' + '; '.join(seen)}", flush=True)
            if not good:
                failed.append(f"{kind} {code} {side}")
    return failed


def check_suspend(folder):
    """Suspends the guest to RAM under the cell; gives what went wrong. Its arm may resume by itself, but not after that."""
    job = guest_job(folder, "suspend", "guest-suspend.sh")
    said = subprocess.run([VM, "--vivid", "--timeout", "60", job, "--", "sh", "guest-suspend.sh"], stdout=subprocess.PIPE, text=True).stdout
    _, slept, after = said.partition("the machine was suspended for ")
    wanted = ["arm on hold", "left camera delivers again", "right camera delivers again", "too late"]
    missing = [words for words in wanted if words not in after]
    if not slept or missing or "arm released" in after or "exit code 0" not in said:
        print(f"suspend: FAILED, missing {missing or 'nothing else'}:\n{said}", flush=True)
        return ["suspend"]
    print(f"suspend: {after.split(';')[0]} noticed, the arm is on hold, what was seen before is too late", flush=True)
    return []


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--short", action="store_true", help="fewer faults, for CI")
    parser.add_argument("--keep", action="store_true", help="keep the folder with everything that was said")
    options = parser.parse_args()
    faults = ["unplug", "damaged", "dark"] if options.short else list(FAULTS)
    # Scenes with few enough rods that some lie free; the later, the fewer.
    names = [f"{9 + 2 * i:04}" for i in range(len(faults) + 2)]
    folder = Path(tempfile.mkdtemp(prefix="pickcell-vm-"))
    failed = []
    if not options.short:
        failed += check_formats(folder, "vivid", ["YUYV", "GREY", "RGB3", "BGR3", "NV12"])
        for code in ["YUYV", "MJPG", "GREY"]:
            failed += check_formats(folder, "loopback", [code])
            shutil.rmtree(folder / "job-loopback")
        failed += check_suspend(folder)
    arm = Arm(folder)
    guest = Guest(folder, arm, names, limit_s=240 if options.short else 420)
    targets = 0
    try:
        for step, name in zip(["start", "next scene"] + faults, names):
            begin = time.monotonic()
            problem = guest.perform(FAULTS.get(step, []))
            if step != "start":
                guest.command(f"show {name}")
            grasp, across, along = None, 0.0, 0.0
            end = time.monotonic() + 90
            scenes = set()
            # What is picked of the scene before has to be right as well: it was in view when the frames were taken.
            while name not in scenes and not problem:
                grasp = arm.next_grasp(end - time.monotonic())
                if grasp is None:
                    problem = "no part was picked within 90 s"
                    break
                scenes = guest.scenes_of_target(targets)
                targets += 1
                problem, across, along = min((judge(scene, grasp) for scene in scenes), key=lambda j: j[1] + j[2])
            if grasp is None:
                print(f"{step:<10} scene {name}: FAILED: {problem}", flush=True)
                failed.append(step)
                break
            verdict = f"FAILED: {problem}" if problem else "ok"
            print(f"{step:<10} scene {name}: picked {across:.2f} mm across, {along:.2f} mm along, "
                  f"after {time.monotonic() - begin:.1f} s: {verdict}", flush=True)
            if problem:
                failed.append(step)
    finally:
        (guest.out / "stop").touch()
        code = guest.process.wait()
        arm.process.terminate()
        arm.process.wait()
    counts = guest.counts()
    for fault, count in [("damaged", "frames_damaged"), ("short", "frames_cut_short")]:
        if fault in faults:
            print(f"{fault:<10} counted: {counts.get(count)} {count.replace('_', ' ')}", flush=True)
            if counts.get(count, 0) < 5:
                failed.append(f"{count} not counted")
    if counts.get("candidates_refused_by_the_last_gate") != 0:
        failed.append("the last gate had to refuse something")
    if code != 0:
        failed.append(f"exit code {code} of the cell")
    if failed or options.keep:
        print(f"vm: what was said is in {folder}")
    else:
        shutil.rmtree(folder)
    if failed:
        for name, count in [("run.log", 20), ("run.jsonl", 4)]:
            path = guest.out / name
            for line in path.read_text(errors="replace").splitlines()[-count:] if path.exists() else []:
                print("   ", line[:300])
        print("vm: FAILED:", ", ".join(failed))
        return 1
    print("vm: every grasp was right, and the cell recovered from every fault")
    return 0


if __name__ == "__main__":
    sys.exit(main())
