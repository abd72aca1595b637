#!/bin/bash
# Prints the section of CHANGELOG.md for a tag, and checks that the repository has the version of the tag.
#
# usage: deploy/release_notes.sh TAG
#
# TAG is `v` and the version in Cargo.toml and python/Cargo.toml, such as v0.2.0. The section of CHANGELOG.md needs the
# date of the release: `## 0.2.0 - 2030-01-31`.
set -euo pipefail
tag=$1
cd "$(dirname "$0")/.."

for file in Cargo.toml python/Cargo.toml; do
    version=$(sed -n 's/^version = "\(.*\)"$/\1/p' "$file")
    if [ "$tag" != "v$version" ]; then
        echo "the tag is $tag, expected v$version ($file)" >&2
        exit 1
    fi
done

heading=$(grep -nxE "## ${version//./\\.} - [0-9]{4}-[0-9]{2}-[0-9]{2}" CHANGELOG.md || true)
if [ "$(grep -c . <<<"$heading")" != 1 ] || ! date --date "${heading##* - }" >/dev/null 2>&1; then
    echo "CHANGELOG.md needs one heading of the form \`## $version - YYYY-MM-DD\`, found: ${heading:-none}" >&2
    exit 1
fi
notes=$(tail -n "+$((${heading%%:*} + 1))" CHANGELOG.md | sed '/^## /,$d')
if ! grep -q '[^[:space:]]' <<<"$notes"; then
    echo "CHANGELOG.md: the section of $version is empty" >&2
    exit 1
fi
sed '1{/^$/d}' <<<"$notes"
