#!/bin/sh
# Puts the greenhouse daemon on this machine, or brings it up to date: run it as often as you like.
# A configuration that is there is never overwritten; the daemon is restarted only when it accepts it.
set -eu
umask 022 # the daemon's user reads what root puts here

usage() {
    cat <<EOF
usage: install.sh [--dry-run] [--root DIR]
  --dry-run   say what would be done, do nothing
  --root DIR  install into DIR, a file system that is not running: no user, no service is touched
Environment: PYTHON, the interpreter of the virtual environment (python3)
EOF
}

die() {
    echo "install.sh: $*" >&2
    exit 1
}

run() { # a step: told, and done unless --dry-run
    echo "  $*"
    [ -n "$dry_run" ] || "$@"
}

install_program() {
    run install -d "$opt"
    parts="pyproject.toml README.md CHANGELOG.md edge firmware_protocol deploy"
    [ ! -d "$opt/src/fleet" ] || parts="$parts fleet" # a fleet's programs run from the same place
    # The source as it was installed: a build leaves files beside its sources, and shall leave this folder alone.
    run rm -rf "$opt/src"
    run install -d "$opt/src"
    for part in $parts; do
        run cp -R "$source/$part" "$opt/src/"
    done
    run find "$opt/src" -name __pycache__ -prune -exec rm -rf {} +
    [ -x "$opt/venv/bin/python" ] || run "$python" -m venv "$opt/venv"
    run "$opt/venv/bin/python" -m pip install --quiet --disable-pip-version-check "$opt/src[page]"
    run install -d "$root/usr/local/bin"
    run ln -sfn /opt/greenhouse/venv/bin/greenhouse "$root/usr/local/bin/greenhouse"
}

name_rig() { # by its machine: two rigs of one name evict each other from a broker
    name=$("$opt/venv/bin/python" -P -c 'from edge.app.setup import rig_name; from edge.config.loading import load; print(rig_name(load("/etc/greenhouse/edge.yaml")))')
    run sed -i "s/^  rig: [^ ]*/  rig: \"$name\"/" "$etc/edge.yaml"
}

install_config() {
    if [ -e "$etc/edge.yaml" ]; then
        echo "  $etc/edge.yaml is kept"
    else
        run install -D -m 0640 "$source/deploy/edge.example.yaml" "$etc/edge.yaml"
        [ -n "$dry_run$root" ] || name_rig
    fi
    # Where the user does not exist, because this system is only being prepared, root has the folders.
    if [ -n "$dry_run" ]; then
        echo "  systemd-tmpfiles --create $source/deploy/greenhouse.tmpfiles"
    else
        sed "${owner:+s/ greenhouse\(-page\)\?\>/ $owner/g}" "$source/deploy/greenhouse.tmpfiles" |
            systemd-tmpfiles ${root:+--root="$root"} --create -
    fi
}

install_system_files() {
    for unit in $units; do
        run install -D -m 0644 "$source/deploy/$unit" "$root/etc/systemd/system/$unit"
    done
    run install -D -m 0644 "$source/deploy/70-greenhouse.rules" "$root/etc/udev/rules.d/70-greenhouse.rules"
    run install -D -m 0644 "$source/deploy/README.md" "$root/usr/share/doc/greenhouse/README.md"
}

start_service() {
    if [ -n "$root" ] || [ ! -d /run/systemd/system ]; then
        echo "systemd does not run here: the service is in place, nothing is started"
        return
    fi
    if [ -S /run/udev/control ]; then # a container has none, and its board comes by another way
        run udevadm control --reload
        run udevadm trigger --subsystem-match=tty
    fi
    run systemctl daemon-reload
    run systemctl enable --quiet greenhouse.service greenhouse-diagnosis.path greenhouse-page.service
    run systemctl restart greenhouse-diagnosis.path
    run systemctl try-restart greenhouse.service
    run systemctl restart greenhouse-page.service
}

dry_run="" root="" python="${PYTHON:-python3}"
while [ $# -gt 0 ]; do
    case "$1" in
    --dry-run) dry_run=1 ;;
    --root) root="${2:?--root needs a folder}" && shift ;;
    -h | --help) usage && exit 0 ;;
    *) usage >&2 && die "unknown argument $1" ;;
    esac
    shift
done

source=$(cd "$(dirname "$0")/.." && pwd)
units="greenhouse.service greenhouse-diagnosis.path greenhouse-diagnosis.service"
units="$units greenhouse-evidence.service greenhouse-evidence.timer greenhouse-page.service"
opt="$root/opt/greenhouse" etc="$root/etc/greenhouse"

[ -n "$dry_run$root" ] || [ "$(id -u)" = 0 ] || die "must be run as root: sudo deploy/install.sh (or --dry-run)"
command -v "$python" >/dev/null || die "$python is missing: apt install python3 python3-venv"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    die "$python is $("$python" -V 2>&1), Python 3.11 or newer is needed"
"$python" -c 'import ensurepip, venv' 2>/dev/null || die "$python has no venv: apt install python3-venv"

[ ! -L "$opt/venv" ] || die "the Debian package is installed: upgrade that, or first apt remove greenhouse"

owner="" # of every folder; empty: as the file says
if [ -n "$root" ]; then
    owner=$(id -u)
else
    run systemd-sysusers "$source/deploy/greenhouse.sysusers"
fi
install_program
install_config
install_system_files
run "$opt/venv/bin/greenhouse" check-config "$etc/edge.yaml"
start_service
[ -n "$dry_run" ] || cat <<EOF
Installed. On a first installation now
  greenhouse setup (the board, its outputs, the box), or
  edit $etc/edge.yaml, then: greenhouse check-config $etc/edge.yaml
  systemctl start greenhouse; journalctl -fu greenhouse
The page runs for this machine alone; for a browser elsewhere: sudo greenhouse page pair
EOF
