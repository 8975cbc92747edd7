#!/bin/sh
# Runs the cell on the test driver's cameras with a simulated arm, suspends the guest to RAM for twelve seconds under it, and
# prints what the cell said. After waking nothing goes to /out any more.
sed -e "s,^device = .*_0_SIM.*,device = \"$CAM0\"," -e "s,^device = .*_1_SIM.*,device = \"$CAM1\"," -e '/^controls/d' -e '/^pair_window_ms/d' \
    -e 's,^format = .*,format = "YUYV",' -e 's,^rate_hz = .*,rate_hz = 15.0,' -e 's,^link = .*,link = "replay",' \
    cell.toml >/tmp/cell.toml
cp calibration.yaml rod-90.toml /tmp
./pickcell run --cell /tmp/cell.toml --overlay none >/tmp/run.txt 2>/tmp/run.log &
cell=$!
sleep 6
rtc=/sys/class/rtc/rtc0
echo $(($(cat $rtc/since_epoch) + 12)) >$rtc/wakealarm
echo mem >/sys/power/state
sleep 6
kill -TERM $cell
wait $cell
echo "exit code $?"
grep -v '^pair' /tmp/run.log
grep 'too late' /tmp/run.txt
