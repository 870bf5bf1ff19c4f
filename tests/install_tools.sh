#!/bin/sh
# Debian packages that the tests use: a broker, compilers and a simulator for the board's C code,
# openssl for test certificates, a browser and a proxy for the page.
set -eu

missing=""
need() { command -v "$1" >/dev/null 2>&1 || missing="$missing $2"; }
need mosquitto mosquitto
need gcc gcc
need avr-gcc gcc-avr
need avrdude avrdude
need openssl openssl
need strace strace
need chromium chromium
need chromedriver chromium-driver
need caddy caddy
need systemd-analyze systemd
need shellcheck shellcheck
[ -e /usr/lib/avr/include/avr/io.h ] || missing="$missing avr-libc"
[ -e /usr/share/arduino/hardware/arduino/avr/bootloaders ] || missing="$missing arduino-core-avr"
[ -e /usr/include/simavr/sim_avr.h ] || missing="$missing libsimavr-dev"
[ -e /usr/include/libelf.h ] || missing="$missing libelf-dev"
[ -n "$missing" ] || exit 0

if [ "$(id -u)" = 0 ]; then as_root=""; elif command -v sudo >/dev/null 2>&1; then as_root="sudo"; else
    echo "The tests need these Debian packages:$missing" >&2
    exit 1
fi
echo "installing$missing"
$as_root apt-get update -qq
# Debian starts a mosquitto of its own, on the loopback port 1883; the tests use theirs, on free ports.
# shellcheck disable=SC2086 # words are meant
DEBIAN_FRONTEND=noninteractive $as_root apt-get install -y -qq --no-install-recommends $missing >/dev/null
