#!/bin/sh
# Runs the cell in the guest until the host asks it to end, and sees to it that cameras plugged in anew get their links.
export PICKCELL_LOG=${PICKCELL_LOG:-info}
./pickcell devices >/out/devices.txt 2>&1
./pickcell run --cell cell.toml --out /tmp/overlays --format json >/out/run.jsonl 2>/out/run.log &
cell=$!
known=$(ls /sys/class/video4linux)
while kill -0 $cell 2>/dev/null; do
    # Only then: it takes all links away for a moment, which udev does not.
    seen=$(ls /sys/class/video4linux)
    [ "$seen" = "$known" ] || { known=$seen; camlinks >/dev/null; }
    [ -e /out/stop ] && kill -TERM $cell
    sleep 0.5
done
wait $cell
