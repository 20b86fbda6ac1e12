#!/bin/sh
# All tests, with the given pytest: the browser's beside the others, because each of the
# two leaves time to the other. Its output comes when it is complete.
set -u
log=$(mktemp)
"$@" tests/browser >"$log" 2>&1 &
browser=$!
trap 'kill "$browser" 2>/dev/null; rm -f "$log"; exit 130' INT TERM
"$@" --ignore=tests/browser
others=$?
wait "$browser"
seen=$?
cat "$log"
rm -f "$log"
[ "$others" -eq 0 ] && [ "$seen" -eq 0 ]
