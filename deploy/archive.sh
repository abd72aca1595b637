#!/bin/bash
# Packs a built program into the archive of a release.
#
# usage: deploy/archive.sh PROGRAM OUT_DIR
#
# Writes loopboost-VERSION-x86_64-unknown-linux-gnu.tar.gz and its SHA-256 file into OUT_DIR. The archive contains the
# stripped program, the README, the changelog, the licences, completions and man pages. The same program gives the same
# bytes. Needs binutils.
set -euo pipefail
export LC_ALL=C
umask 022
program=$(realpath "$1")
mkdir -p "$2"
out=$(realpath "$2")
cd "$(dirname "$0")/.."

target=x86_64-unknown-linux-gnu
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' Cargo.toml)
if [ "$("$program" --version)" != "loopboost $version" ]; then
    echo "found $("$program" --version), expected loopboost $version (Cargo.toml)" >&2
    exit 1
fi
machine=$(readelf -h "$program" | sed -n 's/^ *Machine: *//p')
if [ "$machine" != 'Advanced Micro Devices X86-64' ]; then
    echo "found a program for $machine, expected $target" >&2
    exit 1
fi

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
name=loopboost-$version-$target
root=$folder/$name
mkdir -p "$root/completions" "$root/man"
strip -o "$root/loopboost" "$program"
chmod 755 "$root/loopboost"
install -m 644 README.md CHANGELOG.md LICENSE-APACHE LICENSE-MIT "$root"
"$root/loopboost" completions bash >"$root/completions/loopboost.bash"
"$root/loopboost" completions zsh >"$root/completions/_loopboost"
"$root/loopboost" completions fish >"$root/completions/loopboost.fish"
"$root/loopboost" man "$root/man" >/dev/null

# Nothing of this machine is in the archive: no order of files in a folder, no times, no owners.
tar --create --file "$folder/$name.tar" --directory "$folder" --format=ustar --sort=name \
    --mtime='1980-01-01 00:00:00Z' --owner=0 --group=0 --numeric-owner "$name"
gzip --no-name --best "$folder/$name.tar"
(cd "$folder" && sha256sum "$name.tar.gz" >"$name.tar.gz.sha256")
mv "$folder/$name.tar.gz" "$folder/$name.tar.gz.sha256" "$out"
