#!/bin/bash
# Checks the completions in three shells, and the man pages with groff.
#
# usage: tests/shells.sh LOOPBOOST
#
# LOOPBOOST is the program. Needs zsh, fish and groff.
set -euo pipefail
program=$(realpath "$1")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
ln -s "$program" "$folder/loopboost"
PATH=$folder:$PATH
cd "$folder"
for shell in bash zsh fish; do
    loopboost completions "$shell" >"completions.$shell"
done

# expect WORD... : the words are on standard input, one per line or apart by spaces.
expect() {
    local found
    found=$(tr -s ' \n' '\n')
    for word in "$@"; do
        grep -qxF -- "$word" <<<"$found" || { printf 'expected %s, found:\n%s\n' "$word" "$found" >&2; exit 1; }
    done
}

bash -c 'source completions.bash
COMP_WORDS=(loopboost su) COMP_CWORD=1; _loopboost loopboost su loopboost; echo "${COMPREPLY[@]}"' | expect subsample
bash -c 'source completions.bash
COMP_WORDS=(loopboost run --fo) COMP_CWORD=2; _loopboost loopboost --fo run; echo "${COMPREPLY[@]}"' | expect --force
fish -c 'source completions.fish; complete -C "loopboost model e"' | cut -f 1 | expect export
fish -c 'source completions.fish; complete -C "loopboost run --force op"' | cut -f 1 | expect optimize
zsh -n completions.zsh
zsh -c 'autoload -U compinit; compinit -u -D; source completions.zsh; whence -w _loopboost' | expect function

loopboost man pages
for command in $(loopboost help | sed -n '/^Commands:/,/^$/s/^  \([a-z]*\) .*/\1/p'); do
    [ "$command" = help ] || [ -s "pages/loopboost-$command.1" ] || { echo "no man page of $command" >&2; exit 1; }
done
for page in pages/*.1; do
    warnings=$(groff -man -Tutf8 -ww -z "$page" 2>&1)
    [ -z "$warnings" ] || { echo "$warnings" >&2; exit 1; }
done
groff -man -Tascii -P-c pages/loopboost-model-export.1 | sed 's/.\x08//g' | expect loopboost-model-export --onnx
echo "completions of bash, zsh and fish; $(ls pages | wc -l) man pages"
