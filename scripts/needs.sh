#!/usr/bin/env bash
# Installs what the build needs and this machine lacks, with apt, and says what. Asks nothing. What is there stays.
#   cc, pkg-config    the linker, and crates that build C
#   libclang          reads the system's headers while v4l and iceoryx2 are built (libclang-cpp is another library)
#   what is named     commands that are packages of the same name
# Without apt, or without the right to use it, it says what to install and ends with exit code 1.
set -euo pipefail

has_libclang() {
    [ -n "${LIBCLANG_PATH:-}" ] && return 0
    local found
    found=$(find /usr/lib /usr/lib64 /usr/local/lib -maxdepth 4 -xtype f \
        \( -name 'libclang.so*' -o -name 'libclang-[0-9]*.so*' \) -print -quit 2>/dev/null || true)
    [ -n "$found" ]
}

missing=()
command -v cc >/dev/null || missing+=(gcc libc6-dev)
command -v pkg-config >/dev/null || missing+=(pkg-config)
[ -e /usr/include/linux/videodev2.h ] || missing+=(linux-libc-dev)
has_libclang || missing+=(libclang-dev)
for command in "$@"; do
    command -v "$command" >/dev/null || missing+=("$command")
done

if [ ${#missing[@]} -gt 0 ]; then
    as_root=()
    if [ "$(id -u)" -ne 0 ]; then
        if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
            as_root=(sudo -n)
        else
            echo "needs: missing ${missing[*]}; install them as root: apt-get install ${missing[*]}" >&2
            exit 1
        fi
    fi
    if ! command -v apt-get >/dev/null; then
        echo "needs: missing ${missing[*]} (names of Debian packages), and there is no apt-get: install them" >&2
        exit 1
    fi
    echo "needs: installing ${missing[*]}"
    "${as_root[@]}" apt-get update -qq
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
fi

if ! command -v cargo >/dev/null; then
    echo "needs: cargo is not here: install Rust 1.89 or later with rustup" >&2
    exit 1
fi
