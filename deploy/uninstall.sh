#!/bin/sh
# Takes the daemon off this machine. Configuration, history and user stay; how to remove them is said at the end.
set -eu

root=""
if [ "${1:-}" = --root ]; then root="${2:?--root needs a folder}"; fi
if [ -z "$root" ] && [ "$(id -u)" != 0 ]; then
    echo "uninstall.sh: must be run as root" >&2
    exit 1
fi
if [ -L "$root/opt/greenhouse/venv" ]; then
    echo "uninstall.sh: this is the Debian package's: apt remove greenhouse" >&2
    exit 1
fi
if [ -e "$root/etc/systemd/system/greenhouse-fleet.target" ]; then
    echo "uninstall.sh: a fleet runs from $root/opt/greenhouse: first greenhouse fleet down" >&2
    exit 1
fi
if [ -z "$root" ] && [ -d /run/systemd/system ]; then
    # Stopping turns the heater off.
    systemctl disable --now greenhouse-page.service greenhouse-evidence.timer greenhouse-diagnosis.path \
        greenhouse.service || true
fi
rm -f "$root/etc/systemd/system/greenhouse.service" "$root/etc/systemd/system/greenhouse-diagnosis.path" \
    "$root/etc/systemd/system/greenhouse-diagnosis.service" \
    "$root/etc/systemd/system/greenhouse-evidence.service" "$root/etc/systemd/system/greenhouse-evidence.timer" \
    "$root/etc/systemd/system/greenhouse-page.service" "$root/etc/udev/rules.d/70-greenhouse.rules" \
    "$root/usr/local/bin/greenhouse"
rm -rf "$root/opt/greenhouse" "$root/usr/share/doc/greenhouse"
if [ -z "$root" ] && [ -d /run/systemd/system ]; then
    systemctl daemon-reload
    [ ! -S /run/udev/control ] || udevadm control --reload
fi
cat <<EOF
Removed. Kept: $root/etc/greenhouse, $root/var/lib/greenhouse and $root/var/lib/greenhouse-page.
To remove those too: rm -r $root/etc/greenhouse $root/var/lib/greenhouse $root/var/lib/greenhouse-page;
userdel greenhouse-page; userdel greenhouse
EOF
