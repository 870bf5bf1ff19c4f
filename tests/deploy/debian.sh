#!/bin/sh
# Makes a tree of Debian 12 to try the package in, once: out/deb-test/debian-ARCH.tar. Prints its path.
# usage: debian.sh ARCH   root's; packages: debootstrap, for another architecture than the machine's qemu-user-static
set -eu
arch="${1:?usage: debian.sh ARCH}"
folder=$(realpath "$(dirname "$0")/../../out")/deb-test
tar="$folder/debian-$arch.tar"
if [ ! -e "$tar" ]; then
    mkdir -p "$folder"
    work=$(mktemp -d -p "$folder")
    trap 'rm -rf "$work"' EXIT
    debootstrap --arch="$arch" --variant=minbase --include=python3,systemd-sysv,udev,kmod,libstdc++6 \
        bookworm "$work/tree" >"$work/log" || { cat "$work/log" >&2 && exit 1; }
    rm -f "$work"/tree/var/cache/apt/archives/*.deb
    tar -C "$work/tree" -cf "$tar.new" . && mv "$tar.new" "$tar"
fi
echo "$tar"
