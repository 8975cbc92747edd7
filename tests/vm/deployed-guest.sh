#!/bin/bash
# What deployed.sh has the guest do, a Debian with systemd as its first process: install, run, break, boot again, uninstall.
# Writes to /out/deployed.log, and at the end /out/passed or /out/failed.
exec >>/out/deployed.log 2>&1
cd /src

say() { echo "[$(cut -d' ' -f1 /proc/uptime)] $*"; }
finish() { say "$1"; touch "/out/$1"; sync; systemctl poweroff -ff; exit; }
fail() {
    systemctl --no-pager -l status pickcell pickcell-bridge
    journalctl --no-pager -b -o short-precise -u pickcell -u pickcell-bridge | tail -200
    # Last, where a cut log still shows it.
    say "FAILED: $*"
    finish failed
}
# expect WHAT COMMAND...: the command succeeds within 60 s.
expect() {
    local what=$1 end=$((SECONDS + 60))
    shift
    until "$@"; do
        [ $SECONDS -lt $end ] || fail "$what"
        sleep 0.2
    done
    say "ok: $what"
}
of() { systemctl show pickcell -P "$1"; }
status_says() { of StatusText | grep -q "$1"; }
no_camera_missing() { of StatusText | grep "pairs" | grep -v -q "camera:"; }
is() { [ "$(of "$1")" = "$2" ]; }
done_count() { of StatusText | sed -n 's/.* \([0-9]*\) done.*/\1/p'; }
more_done() { [ "$(done_count)" -ge $((before + 2)) ]; }
picks() {
    before=$(done_count)
    before=${before:-0}
    expect "$1" more_done
}
says() { journalctl --no-pager -b -o cat -u "$1" | grep -q "$2"; }
warned_since() { journalctl --no-pager -b -o cat -p warning -u pickcell --since "$1" | grep -q "$2"; }
as_pickcell() { setpriv --reuid pickcell --regid pickcell --init-groups "$@"; }
release() { systemctl kill -s USR1 --kill-who=main pickcell; }

plug_devices_in() {
    modprobe -a vhci-hcd uvcvideo ftdi_sio
    mkfifo /run/cam.ctl
    uvcsim --cameras 2 --size 640x480 --fps 10 --strip-dht --scene /scene --hold 10 --shown /out/shown.csv \
        --ctl /run/cam.ctl >/out/uvcsim.log 2>&1 &
    expect "udev names the cameras by their ports" eval '[ "$(ls /dev/pickcell 2>/dev/null | wc -l)" = 2 ]'
}

first_boot() {
    make install || fail "make install"
    systemctl enable --now pickcell || fail "the installed cell starts"
    expect "it runs on the recorded session and ends" is ActiveState inactive
    is ExecMainStatus 0 || fail "with exit code 0"
    cp calibration.yaml rod-90.toml /etc/pickcell/
    cp live-cell.toml /etc/pickcell/cell.toml

    systemctl start pickcell || fail "a cell without its devices starts"
    expect "it says that it waits for its cameras" status_says "left camera: unplugged.*right camera: unplugged"
    plug_devices_in
    for device in /dev/pickcell/camera-* /dev/ttyUSB0; do
        expect "the user pickcell may use $device" as_pickcell test -r "$device" -a -w "$device"
    done
    expect "cameras and arm are found" eval 'no_camera_missing && status_says "on hold"'
    release
    picks "it picks after the release"

    local pid threads
    pid=$(of MainPID)
    threads=$(for t in /proc/"$pid"/task/*; do chrt -p "$(basename "$t")"; done)
    [ "$(grep -c SCHED_FIFO <<<"$threads")" -ge 4 ] || fail "real-time rights: $threads"
    [ "$(sed -n 's/VmLck:[^0-9]*\([0-9]*\).*/\1/p' "/proc/$pid/status")" -gt 0 ] || fail "locked memory"
    as_pickcell pickcell check --cell /etc/pickcell/cell.toml |
        grep -q "EBUSY\|another program" || fail "check beside a running cell says who has the cameras"

    local unplugged
    sleep 1
    unplugged=$(date "+%F %T")
    echo "unplug 1" >/run/cam.ctl
    expect "an unplugged camera is told" status_says "right camera: unplugged"
    expect "as a warning" warned_since "$unplugged" "right camera: unplugged"
    echo "plug 1" >/run/cam.ctl
    expect "it is found again" no_camera_missing
    picks "it picks again"

    kill -STOP "$pid"
    expect "a cell that hangs is killed and started again" eval '[ "$(of NRestarts)" = 1 ] && is ActiveState active'
    says pickcell "Watchdog timeout" || fail "by the watchdog"
    expect "and stands on hold" status_says "arm on hold"
    systemctl kill -s KILL pickcell
    expect "a killed cell is started again" eval '[ "$(of NRestarts)" = 2 ] && is ActiveState active'
    expect "and stands on hold" status_says "arm on hold"
    release
    picks "it picks after the release"
    systemctl stop pickcell
    is ExecMainStatus 0 && is Result success || fail "it stops with exit code 0"

    sed -i 's/^pair_window_ms/pair_windw_ms/' /etc/pickcell/cell.toml
    systemctl start pickcell && fail "a wrong cell.toml is refused"
    sleep 3
    is ActiveState failed && is ExecMainStatus 2 && is NRestarts 0 || fail "exit code 2, and no restart"
    says pickcell "pair_windw_ms: there is no such key" || fail "the key is named"
    sed -i 's/^pair_windw_ms/pair_window_ms/; s/^link = .*/link = "shared-memory"/' /etc/pickcell/cell.toml

    systemctl enable --now pickcell-bridge && systemctl start pickcell || fail "cell and bridge start"
    expect "they meet" status_says "arm on hold"
    release
    picks "it picks through shared memory"
    systemctl restart pickcell-bridge
    expect "the bridge may be restarted" status_says "arm on hold"
    release
    picks "it picks again"
    touch /second
    sync
    systemctl reboot
}

second_boot() {
    expect "after a boot the bridge stands" says pickcell-bridge "the bridge stands"
    expect "and the cell waits for its cameras" status_says "left camera: unplugged"
    plug_devices_in
    expect "cameras and arm are found" eval 'no_camera_missing && status_says "arm on hold"'
    release
    picks "it picks after the release"
    make uninstall || fail "make uninstall"
    systemctl is-active pickcell pickcell-bridge && fail "what is uninstalled is ended"
    [ -e /etc/pickcell/cell.toml ] && [ ! -e /usr/local/bin/pickcell ] || fail "the cell stays, the programs go"
    finish passed
}

if [ -e /second ]; then second_boot; else first_boot; fi
