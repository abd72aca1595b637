#!/bin/bash
# Tags, versions and changelogs that fit together or do not, for deploy/release_notes.sh.
#
# usage: tests/release_notes.sh
set -euo pipefail
root=$(realpath "$(dirname "$0")/..")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/deploy" "$folder/python"
cp "$root/deploy/release_notes.sh" "$folder/deploy"

# made VERSION PYTHON_VERSION CHANGELOG: a repository with these versions. Other tables also have versions.
made() {
    printf '[package]\nversion = "%s"\n[dependencies]\nclap = { version = "4.6" }\n' "$1" >"$folder/Cargo.toml"
    printf '[package]\nversion = "%s"\n' "$2" >"$folder/python/Cargo.toml"
    printf '%b' "$3" >"$folder/CHANGELOG.md"
}
# refused TAG MESSAGE
refused() {
    local output
    if output=$("$folder/deploy/release_notes.sh" "$1" 2>&1); then
        echo "FAILED: $1 was accepted, expected: $2" >&2
        exit 1
    fi
    grep -qF "$2" <<<"$output" || { printf 'FAILED: expected %s, found:\n%s\n' "$2" "$output" >&2; exit 1; }
}

log='# Changelog\n\n## Unreleased\n\n- c\n\n## 0.2.0 - 2030-01-31\n\n### Changed\n\n- b\n\n## 0.1.0 - 2029-12-01\n\n- a\n'
made 0.2.0 0.2.0 "$log"
expected=$'### Changed\n\n- b'
found=$("$folder/deploy/release_notes.sh" v0.2.0)
[ "$found" = "$expected" ] || { printf 'FAILED: expected:\n%s\nfound:\n%s\n' "$expected" "$found" >&2; exit 1; }
refused v0.1.0 'expected v0.2.0 (Cargo.toml)'
refused 0.2.0 'expected v0.2.0 (Cargo.toml)'
made 0.2.0 0.1.0 "$log"
refused v0.2.0 'expected v0.1.0 (python/Cargo.toml)'
for heading in '0.2.0' '0.2.0 - Unreleased' '0.2.0 - 2030-02-31' '0.2.00 - 2030-01-31' '0x2.0 - 2030-01-31'; do
    made 0.2.0 0.2.0 "# Changelog\n\n## $heading\n\n- b\n"
    refused v0.2.0 'CHANGELOG.md needs one heading'
done
made 0.2.0 0.2.0 '## 0.2.0 - 2030-01-31\n\n- b\n\n## 0.2.0 - 2030-01-30\n\n- a\n'
refused v0.2.0 'CHANGELOG.md needs one heading'
made 0.2.0 0.2.0 '## 0.2.0 - 2030-01-31\n\n## 0.1.0 - 2029-12-01\n\n- a\n'
refused v0.2.0 'the section of 0.2.0 is empty'

# The versions in the repository are those of one release.
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' "$root/Cargo.toml")
python=$(sed -n 's/^version = "\(.*\)"$/\1/p' "$root/python/Cargo.toml")
[ "$version" = "$python" ] || { echo "Cargo.toml has version $version, python/Cargo.toml $python" >&2; exit 1; }
echo "release notes of one version, and ten refusals"
