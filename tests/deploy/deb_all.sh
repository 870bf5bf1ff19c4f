#!/bin/sh
# Builds the Debian packages twice, holds them to lintian, and tries them on amd64, and on arm64 by emulation.
# usage: deb_all.sh PYTHON   root's; keeps what it prints in bench/results/deb.txt
set -eu
python="${1:?usage: deb_all.sh PYTHON}"
source=$(cd "$(dirname "$0")/../.." && pwd)
cd "$source"
missing=""
for pair in debootstrap:debootstrap lintian:lintian systemd-nspawn:systemd-container qemu-aarch64-static:qemu-user-static; do
    command -v "${pair%:*}" >/dev/null || missing="$missing ${pair#*:}"
done
[ -z "$missing" ] || { echo "deb_all.sh: apt install$missing" >&2 && exit 1; }

emulate_arm64() { # the kernel starts arm64 programs in qemu, in a chroot too
    [ -e /proc/sys/fs/binfmt_misc/register ] || mount -t binfmt_misc none /proc/sys/fs/binfmt_misc
    [ -e /proc/sys/fs/binfmt_misc/qemu-aarch64 ] ||
        tr -d '\n' </usr/lib/binfmt.d/qemu-aarch64.conf >/proc/sys/fs/binfmt_misc/register
}

build() { # prints the packages' names and sizes, and compares a second build of each
    sh deploy/deb/build.sh "$python" | sed "s,$source/,,"
    sha256sum out/deb/*.deb >out/deb/first
    sh deploy/deb/build.sh "$python" >out/deb/second.log
    sha256sum --quiet --check out/deb/first && echo "a second build gives the same bytes"
}

every_test() {
    "$python" -c 'from bench.header import header; print(*header(), sep="\n")'
    build
    for deb in out/deb/*_amd64.deb out/deb/*_arm64.deb; do
        lintian --allow-root --fail-on error --tag-display-limit 3 "$deb" >out/deb-test/lintian.log 2>&1 ||
            { cat out/deb-test/lintian.log && return 1; }
        echo "lintian: no error, $(grep -c '^W:' out/deb-test/lintian.log) warnings"
    done
    sh tests/deploy/deb_test.sh out/deb/*_amd64.deb chroot
    sh tests/deploy/deb_test.sh out/deb/*_amd64.deb boot
    echo "arm64 is emulated by qemu, which says nothing of speed, and whose own memory is in every figure of memory"
    sh tests/deploy/deb_test.sh out/deb/*_arm64.deb chroot
    echo "every test has passed"
}

emulate_arm64
mkdir -p out/deb out/deb-test
rm -f out/deb/*.deb
every_test | tee out/deb-test/results.txt
tail -n 1 out/deb-test/results.txt | grep -q '^every test has passed' # a pipe hides what every_test returns
cp out/deb-test/results.txt bench/results/deb.txt
