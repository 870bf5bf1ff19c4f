#!/bin/sh
# Debian packages that the tests use: a broker, databases, compilers and a simulator for the board's C code,
# openssl for test certificates, a browser and a proxy for the page.
set -eu

PATH="$PATH:/usr/sbin" # a broker is there, where nobody but root looks
missing=""
services=""
need() { command -v "$1" >/dev/null 2>&1 || missing="$missing $2"; }
serve() { command -v "$1" >/dev/null 2>&1 || services="$services $1"; }
serve mosquitto
serve victoria-metrics
serve caddy
need gcc gcc
need avr-gcc gcc-avr
need avrdude avrdude
need openssl openssl
need strace strace
need chromium chromium
need chromedriver chromium-driver
need systemd-analyze systemd
need shellcheck shellcheck
# Its servers' programs are in no path.
set -- /usr/lib/postgresql/*/bin/initdb
[ -e "$1" ] || services="$services postgresql"
[ -e /usr/lib/avr/include/avr/io.h ] || missing="$missing avr-libc"
[ -e /usr/share/arduino/hardware/arduino/avr/bootloaders ] || missing="$missing arduino-core-avr"
[ -e /usr/include/simavr/sim_avr.h ] || missing="$missing libsimavr-dev"
[ -e /usr/include/libelf.h ] || missing="$missing libelf-dev"
missing="$missing$services"
[ -n "$missing" ] || exit 0

if [ "$(id -u)" = 0 ]; then as_root=""; elif command -v sudo >/dev/null 2>&1; then as_root="sudo"; else
    echo "The tests need these Debian packages:$missing" >&2
    exit 1
fi
echo "installing$missing"
$as_root apt-get update -qq
# shellcheck disable=SC2086 # words are meant
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing >/dev/null
# Debian starts what it installs, some of it for the whole network; the tests start theirs, on free ports.
[ -d /run/systemd/system ] || exit 0
for service in $services; do
    $as_root systemctl disable --quiet --now "$service" || true
done
