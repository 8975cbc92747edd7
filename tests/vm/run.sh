#!/bin/sh
# The cell in a virtual machine with real V4L2 devices, and a simulated arm on the host that brings the next scene when
# it has picked. Usage: tests/vm/run.sh [--short]
# Needs ../shared/v4l2-vm and ../shared/scenes beside the project, and python3; says so where they are not there.
set -eu
cd "$(dirname "$0")/../.."
for needed in ../shared/v4l2-vm/v4l2-vm ../shared/scenes/conveyor; do
    [ -e "$needed" ] || { echo "vm: $needed is not here: the test in the virtual machine is left out"; exit 0; }
done
command -v python3 >/dev/null || { echo "vm: python3 is not here: the test in the virtual machine is left out"; exit 0; }
cargo build --release --workspace --bins
exec python3 tests/vm/drive.py "$@"
