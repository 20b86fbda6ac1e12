#!/bin/sh
# Types and unit tests of the page's JavaScript. Node is not needed to use Unghost, so
# a machine without it is told and goes on.
set -eu

skipped() {
    echo "$1: $2 of the page's JavaScript were not checked here."
    exit 0
}

command -v node >/dev/null 2>&1 || skipped "Node is not installed" "types and behaviour"
node -e 'process.exit(process.versions.node.split(".")[0] < 18 ? 1 : 0)' ||
    skipped "Node $(node --version) is older than 18" "types and behaviour"

cd "$(dirname "$0")/../tests/js"
if ! report=$(node --test unit/*.test.js 2>&1); then
    echo "$report"
    exit 1
fi
echo "The page's JavaScript: $(echo "$report" | sed -n 's/^[#ℹ] pass //p') tests passed."
command -v npm >/dev/null 2>&1 || skipped "npm is not installed" "types"
if [ ! node_modules/.package-lock.json -nt package-lock.json ]; then
    npm ci --no-audit --no-fund --loglevel=error || skipped "npm could not fetch its tools" "types"
fi
npm run --silent types
echo "The page's JavaScript: types are sound."
