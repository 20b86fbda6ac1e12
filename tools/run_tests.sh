#!/bin/sh
# All tests, with the given pytest: the browser's beside the others, because each of the
# two leaves time to the other. Their output comes when it is complete. A test that fails
# beside so much else is run once more, with the machine to itself: what fails then is wrong
# and not merely late. Both reports are printed.
set -u
work=$(mktemp -d)
browser=
trap '[ -z "$browser" ] || kill "$browser" 2>/dev/null; rm -rf "$work"' EXIT
trap 'exit 130' INT TERM

"$@" -o cache_dir="$work/browser" tests/browser >"$work/log" 2>&1 &
browser=$!
"$@" -o cache_dir="$work/others" --ignore=tests/browser
others=$?
wait "$browser"
seen=$?
browser=
cat "$work/log"

# Status 1 is failed tests; any other is a run that did not get so far as to name them.
again() {
    [ "$1" -eq 1 ] || return "$1"
    shift
    echo "Once more, alone: what failed beside the other tests."
    "$@" --last-failed --last-failed-no-failures=none
}
again "$others" "$@" -o cache_dir="$work/others" --ignore=tests/browser
others=$?
again "$seen" "$@" -o cache_dir="$work/browser" tests/browser
seen=$?
[ "$others" -eq 0 ] && [ "$seen" -eq 0 ]
