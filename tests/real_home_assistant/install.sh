#!/bin/sh
# Makes a Debian with a Home Assistant of one version in it, once: out/home-assistant/VERSION. Prints its path.
# usage: install.sh VERSION   root's; package: debootstrap
# A Debian of its own, since a Home Assistant needs a newer Python than the Debian of a rig has.
set -eu
# What the test uses, what newer versions load unasked, and the kinds of entity that the page asks for.
integrations="frontend history mqtt analytics backup hassio infrared radio_frequency
ai_task alarm_control_panel assist_satellite calendar camera climate cover fan humidifier light lock media_player
notify remote siren todo tts update vacuum water_heater"
version="${1:?usage: install.sh VERSION}"
here=$(realpath "$(dirname "$0")")
folder=$(realpath "$here/../..")/out/home-assistant
case "$version" in # Python 3.13, and from 2026.3 on 3.14, which Debian 13 has not
2025.* | 2026.1.* | 2026.2.*) suite=trixie ;;
*) suite=testing ;;
esac
base="$folder/$suite" tree="$folder/$version"
log="$folder/install.log"
command -v debootstrap >/dev/null || { echo "install.sh: apt install debootstrap" >&2 && exit 1; }

inside() { # runs a command in the tree "$1", with this machine's names and certificates
    root="$1" && shift
    cp -L /etc/resolv.conf "$root/etc/resolv.conf"
    # shellcheck disable=SC2016 # the inner shell expands
    unshare --mount sh -c 'mount --bind /etc/ssl/certs "$0/etc/ssl/certs" && mount -t proc proc "$0/proc" &&
        exec chroot "$0" "$@"' "$root" "$@"
}

make_base() {
    # Some of what Home Assistant needs comes as source: g++
    debootstrap --variant=minbase --include=python3-venv,python3-dev,g++,libturbojpeg0,ca-certificates \
        "$suite" "$base.new"
    rm -f "$base.new"/var/cache/apt/archives/*.deb
    mv "$base.new" "$base"
}

make_tree() {
    cp -a "$base" "$tree.new"
    inside "$tree.new" python3 -m venv /ha
    cp "$here/requirements.py" "$tree.new/ha/"
    inside "$tree.new" /ha/bin/pip install --quiet "homeassistant==$version"
    # Releases of 2025 do not say that they cannot work with pycares 5, which came after them.
    inside "$tree.new" /ha/bin/python -c "import aiohttp" || inside "$tree.new" /ha/bin/pip install --quiet "pycares<5"
    # shellcheck disable=SC2086 # words are meant
    inside "$tree.new" /ha/bin/python /ha/requirements.py $integrations >"$tree.new/ha/requirements.txt"
    inside "$tree.new" /ha/bin/pip install --quiet --requirement /ha/requirements.txt
    mv "$tree.new" "$tree"
}

mkdir -p "$folder"
rm -rf "$folder"/*.new
exec 3>&1 4>&2 >"$log" 2>&1
trap 'tail -n 20 "$log" >&4' EXIT
[ -e "$base" ] || [ -e "$tree" ] || make_base
[ -e "$tree" ] || make_tree
trap - EXIT
echo "$tree" >&3
