#!/bin/bash
# Builds the documentation site into target/site, and checks its links and its list of Python names.
#
# usage: tests/docs_site.sh BIN
#
# BIN is the folder with the program mkdocs of the packages that CONTRIBUTING.md lists.
set -euo pipefail
root=$(realpath "$(dirname "$0")/..")
mkdocs=$(realpath -s "$1")/mkdocs
cd "$root"
# A notice about later versions, which is not about this site.
export NO_MKDOCS_2_WARNING=1

rm -rf target/site
"$mkdocs" build --strict --site-dir target/site
python3 tests/peers/site_links.py target/site

# python.md lists every public name of the package.
names=$(python3 -c 'import ast
tree = ast.parse(open("python/loopboost/__init__.py").read())
print(*next(ast.literal_eval(s.value) for s in tree.body if isinstance(s, ast.Assign) and s.targets[0].id == "__all__"))')
for name in $names; do
    [ "$name" = __version__ ] || grep -qF "id=\"loopboost.$name\"" target/site/python.html || {
        echo "docs/python.md does not list loopboost.$name" >&2
        exit 1
    }
done

# No page names a folder of the machine that built it.
if grep -rlF "$root" target/site; then
    echo "these files of the site contain the path $root" >&2
    exit 1
fi
