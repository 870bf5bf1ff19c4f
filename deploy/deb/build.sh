#!/bin/sh
# Builds the Debian 12 packages out/deb/greenhouse_VERSION_ARCH.deb, reproducibly: the same commit and the same
# versions.txt give the same bytes. Nothing is compiled to machine code, so one machine builds every architecture.
# usage: build.sh PYTHON [ARCH...]   PYTHON: a Python 3.11 with pip; ARCH: amd64, arm64 (default: both)
# Environment: DEB_VERSION, in the place of the software's own, as 0.1.0+1 for a second package of one release
set -eu
umask 022

die() {
    echo "build.sh: $*" >&2
    exit 1
}

python="${1:?build.sh: usage: build.sh PYTHON [ARCH...]}" && shift
[ $# -gt 0 ] || set -- amd64 arm64
here=$(cd "$(dirname "$0")" && pwd)
source=$(cd "$here/../.." && pwd)
"$python" -c 'import sys, pip; sys.exit(sys.version_info[:2] != (3, 11))' || die "$python: Python 3.11 with pip is needed"
SOURCE_DATE_EPOCH="${SOURCE_DATE_EPOCH:-$(git -C "$source" log -1 --format=%ct)}"
export SOURCE_DATE_EPOCH
version=${DEB_VERSION:-$(sed -n 's/^__version__ = "\(.*\)"/\1/p' "$source/edge/core/version.py")}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir -p "$source/out/deb"

build_wheel() { # from a copy: a build leaves files beside its sources
    mkdir "$work/src"
    (cd "$source" && cp -R pyproject.toml README.md edge firmware_protocol "$work/src")
    "$python" -m pip wheel --quiet --no-deps --wheel-dir "$work" "$work/src"
}

install_packages() { # into $site, for $machine
    platforms="--platform=manylinux2014_$machine $(seq -f "--platform=manylinux_2_%.0f_$machine" 17 36)" # glibc 2.36
    # shellcheck disable=SC2086 # words are meant
    "$python" -m pip install --quiet --no-compile --target "$site" --only-binary=:all: --implementation cp \
        --python-version 3.11 $platforms --constraint "$here/versions.txt" "$(echo "$work"/*.whl)[page]"
    # sqlite-utils asks for pip, for a command of its own; scripts and direct_url.json name this machine's folders.
    rm -rf "$site/bin" "$site"/pip "$site"/pip-*.dist-info "$site"/*.dist-info/direct_url.json
    sed -i -e '/^\.\.\/\.\.\/bin\//d' -e '/\/direct_url\.json,/d' "$site"/*.dist-info/RECORD
    "$python" -m pip list --path "$site" --format freeze | grep -v ^greenhouse-twin= | LC_ALL=C sort -f >"$work/versions"
    diff "$here/versions.txt" "$work/versions" || die "versions.txt is not what was installed: correct it, try again"
    find "$site" -type d -name tests -prune -exec rm -rf {} + # 40 MB of other people's tests
    find "$site" -type f -exec chmod 0644 {} + # wheels mark data as programs
    # Compiled here: the daemon cannot write below /opt, and would compile at every start.
    "$python" -m compileall -q -j 0 --invalidation-mode unchecked-hash -s "$package" -p /opt/greenhouse/venv "$site"
}

fill_program() {
    package="$root/opt/greenhouse/package"
    site="$package/lib/python3.11/site-packages"
    mkdir -p "$package/bin"
    install -m 0755 "$here/greenhouse" "$package/bin/"
    ln -s /usr/bin/python3.11 "$package/bin/python"
    printf 'home = /usr/bin\ninclude-system-site-packages = false\nversion = 3.11\n' >"$package/pyvenv.cfg"
    install_packages
    mkdir -p "$root/usr/bin"
    ln -s /opt/greenhouse/venv/bin/greenhouse "$root/usr/bin/greenhouse"
}

fill_system() {
    deploy="$source/deploy" doc="$root/usr/share/doc/greenhouse"
    install -D -m 0644 -t "$root/lib/systemd/system" "$deploy"/*.service "$deploy"/*.path "$deploy"/*.timer
    install -D -m 0644 "$deploy/70-greenhouse.rules" "$root/lib/udev/rules.d/70-greenhouse.rules"
    install -D -m 0644 "$deploy/greenhouse.sysusers" "$root/usr/lib/sysusers.d/greenhouse.conf"
    install -D -m 0644 "$deploy/greenhouse.tmpfiles" "$root/usr/lib/tmpfiles.d/greenhouse.conf"
    install -D -m 0644 "$here/edge.yaml" "$root/usr/share/greenhouse/edge.yaml"
    install -D -m 0644 -t "$doc" "$deploy/README.md" "$deploy/edge.example.yaml" "$source/CHANGELOG.md"
    install -D -m 0644 -t "$doc/examples" "$deploy"/mosquitto.*.example "$deploy"/board.*example.yaml
    { cat "$here/copyright" && sed 's/^$/./; s/^/ /' "$source/LICENSE"; } >"$doc/copyright"
    install -D -m 0644 "$here/lintian-overrides" "$root/usr/share/lintian/overrides/greenhouse"
    {
        printf 'greenhouse (%s) bookworm; urgency=medium\n\n  * CHANGELOG.md in this folder has the changes.\n\n' "$version"
        echo " -- $(sed -n 's/^Maintainer: //p' "$here/control")  $(LC_ALL=C date -uR -d "@$SOURCE_DATE_EPOCH")"
    } | gzip -9n >"$doc/changelog.gz"
}

fill_control() {
    mkdir "$root/DEBIAN"
    # As dpkg-gencontrol counts: a folder is 1 kB, whatever the file system makes of it.
    size=$(find "$root" -printf '%y %s\n' | awk '{n += $1 ~ /[fl]/ ? int(($2 + 1023) / 1024) : 1} END {print n}')
    sed "s/@VERSION@/$version/; s/@ARCH@/$1/; s/@SIZE@/$size/" "$here/control" >"$root/DEBIAN/control"
    install -m 0755 "$here/preinst" "$here/postinst" "$here/prerm" "$here/postrm" "$root/DEBIAN/"
    (cd "$root" && find . -path ./DEBIAN -prune -o -path ./etc -prune -o -type f -printf '%P\0' |
        LC_ALL=C sort -z | xargs -0 md5sum >DEBIAN/md5sums)
}

build_wheel
for arch in "$@"; do
    case "$arch" in amd64) machine=x86_64 ;; arm64) machine=aarch64 ;; *) die "$arch: amd64 or arm64" ;; esac
    root="$work/$arch"
    fill_program
    fill_system
    fill_control "$arch"
    deb="$source/out/deb/greenhouse_${version}_$arch.deb"
    dpkg-deb --root-owner-group -Zxz -z2 --build "$root" "$deb" >/dev/null
    echo "$deb: $(($(stat -c %s "$deb") / 1000000)) MB, $((size * 1024 / 1000000)) MB installed"
done
