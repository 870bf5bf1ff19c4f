#!/bin/sh
# Builds the programs of all boards: build.sh FOLDER. The same sources and compiler (avr-gcc 5.4.0 and avr-libc 2.0.0 of
# Debian 12) give the same files. KEEP_ELF=1 leaves the files with the symbols too.
set -eu
target=$1
cd "$(dirname "$0")"
version=$(sed -n 's/^#define FIRMWARE_[A-Z]* \([0-9]*\)u$/\1/p' boards/main.c | paste -sd.)
mkdir -p "$target"
rm -f "$target"/*.hex "$target/SHA256SUMS"
for pair in mega2560:atmega2560 uno:atmega328p; do
    program="$target/${pair%%:*}-$version"
    avr-gcc -mmcu="${pair##*:}" -DF_CPU=16000000UL -std=gnu11 -Os -mcall-prologues -mrelax -ffunction-sections \
        -fdata-sections -Wl,--gc-sections -Wall -Wextra -Werror -I. -Idrivers -Iboards \
        gh_*.c drivers/*.c boards/*.c -o "$program.elf"
    avr-objcopy -O ihex -R .eeprom "$program.elf" "$program.hex"
    avr-size "$program.elf" | tail -n 1
    [ -n "${KEEP_ELF:-}" ] || rm "$program.elf"
done
cd "$target"
sha256sum ./*.hex | sed 's|\./||' >SHA256SUMS
