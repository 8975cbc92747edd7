#!/bin/bash
# `make install` on a Debian with systemd and udev, in a virtual machine: the services are started before their devices,
# pick, lose cameras, hang, are killed, get a wrong cell.toml, boot again, and are uninstalled (deployed-guest.sh).
# Needs ../shared/v4l2-vm and ../shared/scenes beside the project, root, and Debian's packages; says so where they are
# not there. The disk of the guest is made once: target/vm/debian.
set -euo pipefail
cd "$(dirname "$0")/../.."
left_out() { echo "deployed: $*: the test of the installed services is left out"; exit 0; }
for needed in ../shared/v4l2-vm/v4l2-vm ../shared/scenes/conveyor; do
    [ -e "$needed" ] || left_out "$needed is not here"
done
[ "$(id -u)" = 0 ] || left_out "only root can make the guest's disk"
get() { apt-get install -y --no-install-recommends "$@" >/dev/null 2>&1; }
command -v debootstrap >/dev/null || get debootstrap || { apt-get update >/dev/null 2>&1 && get debootstrap; } ||
    left_out "debootstrap cannot be installed"

cargo build --release --workspace --bins
vm=$PWD/target/vm
debian=$vm/debian
mkdir -p "$vm"
if [ ! -e "$debian/made" ]; then
    echo "deployed: a Debian for the guest is put into $debian"
    rm -rf "$debian"
    # Where this machine has its packages from, else debootstrap's own choice.
    mirror=$(cat /etc/apt/sources.list /etc/apt/sources.list.d/debian.sources 2>/dev/null |
        sed -n 's/^\(URIs:\|deb\) *\(\[.*\] *\)*\(http[^ ]*\/debian\)\/* *.*/\3/p' | head -1 || true)
    debootstrap --variant=minbase --include=systemd,systemd-sysv,udev,dbus,kmod,make,procps,util-linux \
        bookworm "$debian" ${mirror:+"$mirror"} >"$vm/debootstrap.log" 2>&1 ||
        left_out "no Debian can be fetched, see $vm/debootstrap.log"
    touch "$debian/made"
fi
../shared/v4l2-vm/v4l2-vm --uvc --prepare
cache=${V4L2_VM_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/v4l2-vm}
version=$(cat "$cache/kernel-version")
kernel=$cache/kernel-$version

run=$(mktemp -d "$vm/run.XXXXXX")
arm=
guest=
end() {
    [ -z "$guest" ] || kill "$guest" 2>/dev/null || true
    [ -z "$arm" ] || kill "$arm" 2>/dev/null || true
    rm -rf "$run"
}
trap end EXIT
trap 'exit 130' INT TERM

# The guest's disk: Debian, the kernel's modules, the simulated cameras, and of the project what `make install` needs.
root=$run/root
cp -a "$debian" "$root"
mkdir -p "$root"/{src/target/release,out,scene,lib/modules}
cp -a deploy docs replay scripts Makefile "$root/src/"
cp cell.toml "$root/src/"
cp target/release/{pickcell,firmware-bridge} "$root/src/target/release/"
cp ../shared/scenes/conveyor/calibration.yaml ../shared/scenes/parts/rod-90.toml tests/vm/deployed-guest.sh "$root/src/"
port=/dev/pickcell/camera-platform-vhci_hcd_0-usb-0
sed -e "s,^device = .*SIM0000.*,device = \"${port}_1_1_0\"," -e "s,^device = .*SIM0001.*,device = \"${port}_2_1_0\"," \
    -e 's,^resume = .*,resume = "manual",' -e 's,^state = .*,state = "/var/lib/pickcell/place.state",' \
    tests/vm/cell.toml >"$root/src/live-cell.toml"
cp -a "$kernel/lib/modules/$version" "$root/lib/modules/"
cp "$cache/camsim/release/uvcsim" "$root/usr/local/sbin/"
printf '%s\n' "blacklist uvcvideo" "blacklist ftdi_sio" "options usbcore autosuspend=-1" >"$root/etc/modprobe.d/vm.conf"
printf '%s\n' 9pnet_virtio 9p >"$root/etc/modules-load.d/vm.conf"
share="9p trans=virtio,version=9p2000.L,msize=524288,cache=none"
printf '%s\n' "out /out $share 0 0" "scene /scene $share 0 0" >"$root/etc/fstab"
cat >"$root/etc/systemd/system/deployed.service" <<'UNIT'
[Unit]
After=multi-user.target
[Service]
ExecStart=/bin/bash /src/deployed-guest.sh
UNIT
ln -s ../deployed.service "$root/etc/systemd/system/multi-user.target.wants/"
truncate -s 2500M "$run/disk"
/sbin/mke2fs -q -t ext4 -d "$root" "$run/disk"
rm -rf "$root"

# What brings up that disk.
first=$run/initrd.d
mkdir -p "$first"/{bin,modules,proc,sys,dev,new}
cp /bin/busybox "$first/bin/"
for module in virtio_pci virtio_blk ext4; do
    /sbin/modprobe -S "$version" -d "$kernel" --show-depends "$module" | sed -n 's/^insmod \([^ ]*\).*/\1/p'
done | awk '!seen[$0]++' >"$run/modules"
while read -r module; do
    cp "$module" "$first/modules/"
    echo "insmod /modules/${module##*/}"
done <"$run/modules" >"$first/load"
cat >"$first/init" <<'INIT'
#!/bin/busybox sh
/bin/busybox --install -s /bin
mount -t proc none /proc; mount -t sysfs none /sys; mount -t devtmpfs none /dev
. /load
n=0; until [ -b /dev/vda ] || [ $n = 100 ]; do sleep 0.1; n=$((n + 1)); done
mount -t ext4 /dev/vda /new
mount --move /dev /new/dev; umount /proc /sys
exec switch_root /new /sbin/init
INIT
chmod +x "$first/init"
(cd "$first" && find . | cpio -o -H newc --quiet) >"$run/initrd"

for side in left right; do
    mkdir -p "$run/frames/$side"
    for picture in ../shared/scenes/conveyor/$side/000[0-5].png; do cp "$picture" "$run/frames/$side/"; done
done
"$cache/camsim/release/camframes" --convert "$run/frames" --to "$run/scene" --cameras 2 >/dev/null
target/release/firmware-bridge --log warn simulate --pty "$run/arm" --dialect own --park-mm 120 240 200 >"$run/arm.log" &
arm=$!
for _ in $(seq 100); do [ -e "$run/arm" ] || sleep 0.1; done

mkdir "$run/out"
qemu-system-x86_64 -accel tcg,thread=multi -cpu max -m 1500 -smp 2 -nodefaults -display none \
    -kernel "$kernel/boot/vmlinuz-$version" -initrd "$run/initrd" \
    -append "console=ttyS0 quiet panic=-1 tsc=reliable mitigations=off random.trust_cpu=on" \
    -drive "file=$run/disk,format=raw,if=virtio,cache=unsafe" -serial "file:$run/console" \
    -virtfs "local,path=$run/out,mount_tag=out,security_model=none" \
    -virtfs "local,path=$run/scene,mount_tag=scene,security_model=none" \
    -chardev "serial,id=arm,path=$run/arm" -device qemu-xhci -device usb-serial,chardev=arm,always-plugged=on &
guest=$!
deadline=$((SECONDS + ${DEPLOYED_TIMEOUT:-500}))
while kill -0 "$guest" 2>/dev/null && [ $SECONDS -lt $deadline ]; do sleep 0.5; done
cat "$run/out/deployed.log" 2>/dev/null || tail -20 "$run/console"
[ -e "$run/out/passed" ] || { echo "deployed: failed"; exit 1; }
echo "deployed: passed"
