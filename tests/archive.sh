#!/bin/bash
# Makes the archive of a release twice, compares the bytes, and tries what it contains.
#
# usage: tests/archive.sh PROGRAM [OUT_DIR]
#
# PROGRAM is the built program. The tested archive and its SHA-256 file are copied to OUT_DIR. Needs binutils.
set -euo pipefail
program=$(realpath "$1")
out=${2:+$(realpath -m "$2")}
root=$(realpath "$(dirname "$0")/..")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
fail() {
    echo "FAILED: $*" >&2
    exit 1
}

"$root/deploy/archive.sh" "$program" "$folder/first"
# Another time, mask, time zone, language and folder for temporary files. Times in gzip and tar are whole seconds.
sleep 1
mkdir "$folder/tmp"
(umask 077 && TMPDIR=$folder/tmp TZ=Asia/Tokyo LC_ALL=C.UTF-8 "$root/deploy/archive.sh" "$program" "$folder/second")
diff -r "$folder/first" "$folder/second" || fail "two archives of the same program differ"

cd "$folder/first"
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' "$root/Cargo.toml")
name=loopboost-$version-x86_64-unknown-linux-gnu
[ "$(echo *)" = "$name.tar.gz $name.tar.gz.sha256" ] || fail "expected $name.tar.gz and its SHA-256 file, found $(echo *)"
sha256sum --check --quiet --strict "$name.tar.gz.sha256" || fail "the SHA-256 file is not that of the archive"
# The SHA-256 file finds a changed byte.
mkdir "$folder/changed"
cp -- * "$folder/changed"
printf x >>"$folder/changed/$name.tar.gz"
(cd "$folder/changed" && sha256sum --check --status "$name.tar.gz.sha256") && fail "a changed archive has the same sum"

# Names, modes, owners and times. Each command has a man page, and so has each command of a command.
commands() { sed -n '/^Commands:/,/^$/s/^  \([a-z]*\) .*/\1/p' | sed '/^help$/d'; }
{
    printf '%s\n' CHANGELOG.md LICENSE-APACHE LICENSE-MIT README.md completions/_loopboost completions/loopboost.bash \
        completions/loopboost.fish loopboost man/loopboost.1
    for command in $("$program" help | commands); do
        echo "man/loopboost-$command.1"
        "$program" "$command" --help | commands | sed "s|.*|man/loopboost-$command-&.1|"
    done
} | LC_ALL=C sort >"$folder/expected"
tar --list --file "$name.tar.gz" | sed "s|^$name/||; /\/$/d; /^$/d" >"$folder/listed"
LC_ALL=C sort "$folder/listed" >"$folder/found"
diff "$folder/expected" "$folder/found" || fail "expected the files marked <, found those marked >"
TZ=UTC tar --list --verbose --numeric-owner --full-time --file "$name.tar.gz" >"$folder/verbose"
awk '{ print $1, $2, $4, $5 }' "$folder/verbose" | LC_ALL=C sort -u >"$folder/metadata"
printf '%s 0/0 1980-01-01 00:00:00\n' -rw-r--r-- -rwxr-xr-x drwxr-xr-x | diff - "$folder/metadata" \
    || fail "expected the modes, owners and times marked <, found those marked >"
[ "$(grep -c '^-rwx' "$folder/verbose")" = 1 ] || fail "expected one program"

# The contents.
mkdir "$folder/unpacked"
tar --extract --file "$name.tar.gz" --directory "$folder/unpacked"
cd "$folder/unpacked/$name"
for file in README.md CHANGELOG.md LICENSE-APACHE LICENSE-MIT; do
    cmp "$file" "$root/$file" || fail "$file is not that of the repository"
done
for file in completions/* man/*; do [ -s "$file" ] || fail "$file is empty"; done
readelf --sections --wide loopboost | grep -qE '\.(symtab|debug_info) ' && fail "the program has symbols"
bash -n completions/loopboost.bash

# The program runs alone, in an empty environment.
mkdir "$folder/alone"
cp loopboost "$folder/alone"
cd "$folder/alone"
[ "$(env -i ./loopboost --version)" = "loopboost $version" ] || fail "the program has another version"
env -i ./loopboost inspect "$root/fixtures/corridor.mcap" >inspected 2>messages || fail "inspect: $(cat messages)"
grep -qF '36 complete revolutions' inspected || fail "inspect did not read the log: $(cat inspected)"

if [ -n "$out" ]; then
    mkdir -p "$out"
    cp "$folder/first/"* "$out"
fi
echo "$name.tar.gz: $(wc -l <"$folder/found") files, $(du -h --apparent-size "$folder/first/$name.tar.gz" | cut -f 1)"
