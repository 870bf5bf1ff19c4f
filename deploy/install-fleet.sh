#!/bin/sh
# Puts the programs of a fleet on this machine (Debian 12 or newer), or brings them up to date: run it as often
# as you like. `greenhouse fleet up` starts them.
set -eu
umask 022 # the fleet's user reads what root puts here

die() {
    echo "install-fleet.sh: $*" >&2
    exit 1
}

source=$(cd "$(dirname "$0")/.." && pwd)
opt=/opt/greenhouse
set -- mosquitto victoria-metrics caddy # the engines, by command, package and service

[ "$(id -u)" = 0 ] || die "run it as root"
command -v apt-get >/dev/null || die "this is no Debian: install $* and python3-venv, then see docs/fleet.md"
[ ! -L "$opt/venv" ] || die "the Debian package of the daemon is installed here: first apt remove greenhouse"
brought=""
for engine in "$@"; do
    command -v "$engine" >/dev/null || brought="$brought $engine"
done
apt-get update -q
DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends python3-venv "$@"
# Debian starts what it installs. The fleet has services of its own; what ran here before goes on.
for engine in $brought; do
    systemctl disable --quiet --now "$engine" || true
done
install -d "$opt"
# The source as it was installed: a build leaves files beside its sources, and shall leave this folder alone.
rm -rf "$opt/src"
install -d "$opt/src"
for part in pyproject.toml README.md CHANGELOG.md edge firmware_protocol fleet deploy; do
    cp -R "$source/$part" "$opt/src/"
done
find "$opt/src" -name __pycache__ -prune -exec rm -rf {} +
[ -x "$opt/venv/bin/python" ] || python3 -m venv "$opt/venv"
"$opt/venv/bin/python" -m pip install --quiet --disable-pip-version-check "$opt/src[fleet]"
ln -sfn "$opt/venv/bin/greenhouse" /usr/local/bin/greenhouse
echo "installed; start it: greenhouse fleet up --name THE.NAME.BY.WHICH.RIGS.REACH.IT"
