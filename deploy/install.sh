#!/bin/sh
# Installs the built programs, the service, the udev rule and a first cell.toml. Needs root unless DESTDIR is set.
#   PREFIX   where the programs go (/usr/local)
#   DESTDIR  put in front of every path, for packages
# What is there already in /etc/pickcell stays as it is.
set -eu
cd "$(dirname "$0")/.."
PREFIX=${PREFIX:-/usr/local}
DESTDIR=${DESTDIR:-}
built=${CARGO_TARGET_DIR:-target}/release
share=$PREFIX/share/pickcell
say() { echo "install: $*"; }

for program in pickcell firmware-bridge; do
    [ -x "$built/$program" ] || { echo "install: $built/$program is not there: run make build first" >&2; exit 2; }
    install -D -m 755 "$built/$program" "$DESTDIR$PREFIX/bin/$program"
    say "$DESTDIR$PREFIX/bin/$program"
done
install -D -m 644 docs/deploy.md "$DESTDIR$PREFIX/share/doc/pickcell/deploy.md"
install -d "$DESTDIR$share"
cp -R replay "$DESTDIR$share/"
say "$DESTDIR$share/replay: the recorded session"

# systemd before 254 (Debian 12 has 252) does not know RestartSteps: there the pause is made before the start.
systemd_version=$(systemctl --version 2>/dev/null | sed -n '1s/^systemd \([0-9]*\).*/\1/p')
for unit in pickcell.service pickcell-bridge.service; do
    to=$DESTDIR/etc/systemd/system
    install -d "$to"
    sed "s,/usr/local/,$PREFIX/,g" "deploy/$unit" >"$to/$unit"
    if [ "${systemd_version:-254}" -lt 254 ]; then
        sed -i '/^RestartSteps=/d; /^RestartMaxDelaySec=/d' "$to/$unit"
        install -D -m 644 deploy/backoff.conf "$to/$unit.d/backoff.conf"
    fi
    say "$to/$unit"
done
install -D -m 644 deploy/60-pickcell.rules "$DESTDIR/etc/udev/rules.d/60-pickcell.rules"
install -D -m 644 deploy/pickcell.limits "$DESTDIR/etc/security/limits.d/pickcell.conf"
say "$DESTDIR/etc/udev/rules.d/60-pickcell.rules, $DESTDIR/etc/security/limits.d/pickcell.conf"

cell=$DESTDIR/etc/pickcell/cell.toml
if [ -e "$cell" ]; then
    say "$cell is there already and stays as it is"
else
    install -d "$DESTDIR/etc/pickcell"
    sed -e "s,\"replay/,\"$share/replay/,g" -e 's,"out/,"/var/lib/pickcell/,g' -e 's,"recordings","/var/lib/pickcell/recordings",' cell.toml >"$cell"
    say "$cell: a first cell, on the recorded session"
fi

# The rest is for the machine that this runs on.
[ -z "$DESTDIR" ] || exit 0
if ! getent passwd pickcell >/dev/null; then
    useradd --system --user-group --home-dir /var/lib/pickcell --shell /usr/sbin/nologin pickcell
    say "user pickcell"
fi
for group in video dialout; do
    if getent group "$group" >/dev/null; then usermod -aG "$group" pickcell; fi
done
if command -v systemctl >/dev/null && [ -d /run/systemd/system ]; then
    systemctl daemon-reload
    say "start it with: systemctl enable --now pickcell"
fi
if command -v udevadm >/dev/null && [ -d /run/udev ]; then
    udevadm control --reload && udevadm trigger --subsystem-match=video4linux --subsystem-match=tty
fi
