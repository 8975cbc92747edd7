#!/bin/sh
# Takes away what install.sh has put there, with the same PREFIX and DESTDIR. The cell in /etc/pickcell, its records in
# /var/lib/pickcell and the user pickcell stay: they are not the program's.
set -eu
PREFIX=${PREFIX:-/usr/local}
DESTDIR=${DESTDIR:-}
units=$DESTDIR/etc/systemd/system
say() { echo "uninstall: $*"; }

if [ -z "$DESTDIR" ] && command -v systemctl >/dev/null && [ -d /run/systemd/system ]; then
    # The arm holds before its programs go.
    for unit in pickcell pickcell-bridge; do
        [ ! -e "$units/$unit.service" ] || systemctl disable --now "$unit"
    done
fi
for file in "$PREFIX/bin/pickcell" "$PREFIX/bin/firmware-bridge" "$PREFIX/share/doc/pickcell" "$PREFIX/share/pickcell" \
    /etc/systemd/system/pickcell.service /etc/systemd/system/pickcell.service.d/backoff.conf \
    /etc/systemd/system/pickcell-bridge.service /etc/systemd/system/pickcell-bridge.service.d/backoff.conf \
    /etc/udev/rules.d/60-pickcell.rules /etc/security/limits.d/pickcell.conf; do
    [ -e "$DESTDIR$file" ] || continue
    rm -r "$DESTDIR$file"
    say "$DESTDIR$file is gone"
done
for folder in "$units/pickcell.service.d" "$units/pickcell-bridge.service.d"; do
    # A drop-in of one's own stays.
    rmdir "$folder" 2>/dev/null || true
done
for kept in /etc/pickcell /var/lib/pickcell; do
    [ ! -e "$DESTDIR$kept" ] || say "$DESTDIR$kept stays; remove it by hand where it is not needed any more"
done
if [ -z "$DESTDIR" ] && command -v systemctl >/dev/null && [ -d /run/systemd/system ]; then
    systemctl daemon-reload
fi
if [ -z "$DESTDIR" ] && command -v udevadm >/dev/null && [ -d /run/udev ]; then
    udevadm control --reload
fi
