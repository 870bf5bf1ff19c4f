#!/bin/sh
# Installs, upgrades, breaks, removes and purges the Debian package in a Debian 12 of its own, without a network.
# usage: deb_test.sh DEB [boot|chroot]   root's; packages: those of debian.sh, and for boot systemd-container.
#   `boot` (default) has a running systemd, `chroot` has none.
set -eu
deb=$(realpath "${1:?usage: deb_test.sh DEB [boot|chroot]}") mode="${2:-boot}"
source=$(cd "$(dirname "$0")/../.." && pwd)
arch=$(dpkg-deb -f "$deb" Architecture) version=$(dpkg-deb -f "$deb" Version)
mkdir -p "$source/out/deb-test"
base=$(sh "$source/tests/deploy/debian.sh" "$arch")
work=$(mktemp -d -p "$source/out/deb-test") root="$work/root" passed=0 nspawn="" pid1=""

# the Debian that it is tried in

start() {
    mkdir "$root"
    tar -C "$root" -xf "$base"
    if [ "$mode" = chroot ]; then
        printf '#!/bin/sh\nexit 101\n' >"$root/usr/sbin/policy-rc.d"
        chmod 755 "$root/usr/sbin/policy-rc.d"
        mount -t proc proc "$root/proc"
        mount -t devpts -o newinstance,ptmxmode=0666 devpts "$root/dev/pts"
        ln -sf pts/ptmx "$root/dev/ptmx"
    else
        systemd-nspawn -q -D "$root" --boot --private-network --register=no --keep-unit --machine="gh-$$" \
            >"$work/boot.log" 2>&1 &
        nspawn=$!
        until pid1=$(pgrep -P "$nspawn" -x systemd) && within test -S /run/systemd/private; do sleep 1; done
        until within systemctl is-system-running 2>/dev/null | grep -Eq 'running|degraded'; do sleep 1; done
    fi
}

end() {
    [ -z "$nspawn" ] || { kill -TERM "$nspawn" && wait "$nspawn"; } || true
    umount -l "$root/dev/pts" "$root/proc" 2>/dev/null || true
    rm -rf --one-file-system "$work"
}
trap end EXIT
trap 'exit 1' INT TERM # dash ends without `end` otherwise, and /proc stays mounted below out/

within() {
    if [ "$mode" = chroot ]; then
        unshare --net env -i PATH="$PATH" chroot "$root" "$@"
    else
        nsenter -t "$pid1" -a env -i PATH="$PATH" "$@"
    fi
}

# versions of the package

variant() { # VERSION SCRIPT: the package with that version, after SCRIPT has run in its program
    cp -al "$work/tree" "$work/v" # what SCRIPT changes, it writes anew
    (cd "$work/v/opt/greenhouse/package/lib/python3.11/site-packages/edge" && eval "$2")
    sed -i "s/^Version: .*/Version: $1/" "$work/v/DEBIAN/control"
    dpkg-deb --root-owner-group -Znone -b "$work/v" "$work/$1.deb" >/dev/null
    rm -rf "$work/v"
}

# what is asked and checked

check() { # TEXT COMMAND...
    text="$1" && shift
    if "$@" >"$work/out" 2>&1; then
        passed=$((passed + 1))
        echo "ok   $text"
    else
        echo "FAIL $text: $*" && cat "$work/out" "$work/last" && exit 1
    fi
}
not() { ! "$@"; }
says() { grep -q "$1" "$work/last"; }                 # the last installation
install_deb() {                                       # VERSION
    cp "$work/$1.deb" "$root/srv/x.deb"
    within apt-get install -y --no-install-recommends --allow-downgrades /srv/x.deb >"$work/last" 2>&1
}
version_runs() { within greenhouse --version | grep -q "greenhouse $1"; }
state_is() { [ "$(within dpkg-query -W -f '${db:Status-Status}' greenhouse)" = "$1" ]; }
page_pid() { within systemctl show -P MainPID greenhouse-page; }
daemon_pid() { within systemctl show -P MainPID greenhouse; }
daemon_folder() { within readlink "/proc/$(daemon_pid)/cwd" >/dev/null && within cat "/proc/$(daemon_pid)/cmdline" | tr '\0' ' '; }
runs_from() { daemon_folder | grep -q "^/opt/greenhouse/$1/bin/python "; }
page() { # PATH KEY...: what the page answers to a browser that has just been paired
    link=$(within greenhouse page pair 2>/dev/null)
    within python3 /srv/page_check.py "$link" "$@"
}
page_says() { # VALUE PATH KEY...
    expected="$1" && shift
    found=$(page "$@") && echo "$found" && [ "$found" = "$expected" ]
}
later() { # COMMAND...: within ten seconds
    tries=20
    until "$@"; do
        tries=$((tries - 1)) && [ $tries -gt 0 ] || return 1
        sleep 0.5
    done
}
link_is() { [ "$(readlink "$root/opt/greenhouse/venv")" = "$1" ]; }

renumber='sed -i "s/__version__ = .*/__version__ = \"$v\"/" core/version.py; find core -name "version.*.pyc" -delete'
make_variants() {
    mkdir "$work/tree"
    dpkg-deb -R "$deb" "$work/tree"
    v=$version && variant 1 :
    v=0.2.0 && variant 2 "$renumber"
    # A bit of a model is wrong: the tried program refuses it.
    v=0.3.0 && variant 3-nomodel "$renumber; cd models/default_bundle; sed -i '\$s/\$/x/' lstm.onnx"
    # Everything that can be tried works; the service does not start.
    v=0.3.1 && variant 3.1-nostart "$renumber; sed -i 's/^def run.*/&\n    raise SystemExit(1)/' commands/run.py
        find commands -name 'run.*.pyc' -delete"
    v=0.4.0 && variant 4 "$renumber"
}

without_systemd() {
    check "installs without a network" install_deb 1
    check "the user is there, and may open serial ports" within sh -c 'id -nG greenhouse | grep -qw dialout'
    check "only its group reads the configuration" within sh -c '[ "$(stat -c %U:%G:%a /etc/greenhouse/edge.yaml)" = root:greenhouse:640 ]'
    check "root alone reads the credentials" within sh -c '[ "$(stat -c %U:%a /etc/greenhouse/credentials)" = root:700 ]'
    check "the command is in the PATH" version_runs "$version"
    check "the service is enabled" test -L "$root/etc/systemd/system/multi-user.target.wants/greenhouse.service"
    cp "$source/tests/deploy/deb_numbers.py" "$root/srv/"
    if [ "$arch" = amd64 ]; then
        check "computes" within /opt/greenhouse/venv/bin/python /srv/deb_numbers.py /srv/numbers.json
        cp "$root/srv/numbers.json" "$source/out/deb-test/numbers-amd64.json"
    else
        cp "$source/out/deb-test/numbers-amd64.json" "$root/srv/amd64.json" # missing? try the package of amd64 first
        check "computes as on amd64, to 1e-5 K" \
            within /opt/greenhouse/venv/bin/python /srv/deb_numbers.py /srv/numbers.json /srv/amd64.json
    fi
    sed 's/^/     /' "$work/out"
    check "its files are those of the package" within dpkg --verify greenhouse
    echo 'reference: {reference_c: 25}' >>"$root/etc/greenhouse/edge.yaml"
    check "upgrades" install_deb 2
    check "the new version is in use" version_runs 0.2.0
    check "the settings were kept, and nothing was asked" grep -q 'reference_c: 25' "$root/etc/greenhouse/edge.yaml"
    check "an upgrade with a damaged model fails" not install_deb 3-nomodel
    check "and says why" says 'lstm.onnx: '
    check "dpkg knows of it" state_is half-configured
    check "the version before is in use" version_runs 0.2.0
    echo 'reference: {reference_c: 99}' >"$root/etc/greenhouse/edge.yaml"
    check "an upgrade whose settings are refused fails" not install_deb 4
    check "and says why" says 'reference.reference_c: 99'
    check "the version before is in use" version_runs 0.2.0
    echo 'reference: {reference_c: 25}' >"$root/etc/greenhouse/edge.yaml"
    check "with good settings dpkg finishes the upgrade" within dpkg --configure -a
    check "the new version is in use" version_runs 0.4.0
    touch "$root/var/lib/greenhouse/history.db"
    check "removes" within apt-get remove -y greenhouse
    check "nothing is left in /opt" test ! -e "$root/opt/greenhouse"
    check "settings and history are kept" test -e "$root/etc/greenhouse/edge.yaml" -a -e "$root/var/lib/greenhouse/history.db"
    check "installs again" install_deb 1
    check "with the settings of before" grep -q 'reference_c: 25' "$root/etc/greenhouse/edge.yaml"
    check "purges" within apt-get purge -y greenhouse
    check "settings, history and user are gone" not within sh -c 'ls -d /etc/greenhouse /var/lib/greenhouse* || getent passwd greenhouse greenhouse-page'
    mkdir -p "$root/opt/greenhouse/venv"
    check "an installation by install.sh is not overwritten" not install_deb 1
    check "and its removal is explained" says 'deploy/uninstall.sh'
}

with_systemd() {
    check "installs" install_deb 1
    check "heats only when a person has started it" not within systemctl --quiet is-active greenhouse
    cp "$source/tests/deploy/page_check.py" "$root/srv/"
    check "the page runs" within systemctl --quiet is-active greenhouse-page
    check "and listens to this machine alone" later sh -c "nsenter -t $pid1 -n ss -Hltn sport = :8420 | grep -q '127.0.0.1:8420'"
    check "the page says that the daemon is not there" later page_says False view reached
    check "from then on it listens to the network" later sh -c "nsenter -t $pid1 -n ss -Hltn sport = :8420 | grep -q '\*:8420'"
    check "root's links belong to the page" within sh -c '[ "$(stat -c %U:%a /var/lib/greenhouse-page/page.db)" = greenhouse-page:600 ]'
    check "starts" within systemctl start greenhouse
    check "the page reaches the daemon" later page_says True view reached
    check "the page reads the history" later not page_says None span newest_utc
    check "and cannot write to it" not within runuser -u greenhouse-page -- sh -c 'echo x >>/var/lib/greenhouse/history.db'
    touch "$root/etc/greenhouse/keys/any"
    check "nor see keys" not within nsenter -t "$(page_pid)" -m test -e /etc/greenhouse/keys/any
    kill -STOP "$(pgrep -P "$pid1" -f 'edge run')" # a daemon that hangs
    check "a stop of the page waits for a daemon that hangs" page_says True stop waits
    kill -CONT "$(pgrep -P "$pid1" -f 'edge run')"
    check "and is taken by it" later not test -e "$root/var/lib/greenhouse/stops/stop.json"
    check "the page shows it" later page_says True view status operation emergency_stop
    echo "     the page's memory: $(within systemctl show -P MemoryCurrent greenhouse-page) bytes"
    check "runs as its user, from the folder a" runs_from a
    check "answers" within greenhouse status
    before=$(daemon_pid)
    check "upgrades while it runs" install_deb 2
    check "the daemon was restarted" not test "$before" = "$(daemon_pid)"
    check "runs from the folder b" runs_from b
    check "and so does the page" page_says True view reached
    before=$(daemon_pid)
    check "an upgrade with a damaged model fails" not install_deb 3-nomodel
    check "the daemon was not even restarted" test "$before" = "$(daemon_pid)"
    check "an upgrade that does not start fails" not install_deb 3.1-nostart
    check "and says so" says 'the one before runs again'
    check "dpkg knows of it" state_is half-configured
    check "the version before runs" runs_from b
    check "and answers" within greenhouse status
    check "the next good version repairs it" install_deb 4
    check "it runs" runs_from a
    check "the same in status" within greenhouse status
    kill -STOP "$(pgrep -P "$pid1" -f 'edge run')" # a daemon that hangs
    sleep 170
    check "the watchdog has restarted a daemon that hung" sh -c "[ $(within systemctl show -P NRestarts greenhouse) -ge 1 ]"
    check "removes" within apt-get remove -y greenhouse
    check "the daemon has ended" not within systemctl --quiet is-active greenhouse
    check "and so has the page" not within systemctl --quiet is-active greenhouse-page
    check "purges" within apt-get purge -y greenhouse
    check "systemd knows it no more" not within systemctl cat greenhouse
}

case "$mode" in boot | chroot) ;; *) echo "deb_test.sh: $mode: boot or chroot" >&2 && exit 2 ;; esac
[ "$(id -u)" = 0 ] || { echo "deb_test.sh: must be run as root" >&2 && exit 1; }
echo "greenhouse_${version}_$arch.deb in a Debian 12, $mode"
make_variants
start
if [ "$mode" = chroot ]; then without_systemd; else with_systemd; fi
echo "$passed passed, 0 failed"
