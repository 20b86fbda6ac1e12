#!/bin/sh
# Types and unit tests of the page's JavaScript. Node is not needed to use Unghost, so
# a machine without it is told and goes on; where the variable CI is set, it fails.
set -eu

skipped() {
    echo "$1: $2 of the page's JavaScript were not checked here."
    [ -n "${CI:-}" ] || exit 0
    echo "The variable CI is set: no check is left out in CI. Install Node 18 or newer with npm."
    exit 1
}

# Fetch what the package in this folder needs, once.
fetched() {
    [ node_modules/.package-lock.json -nt package-lock.json ] ||
        npm ci --no-audit --no-fund --loglevel=error || skipped "npm could not fetch its tools" "types"
}

command -v node >/dev/null 2>&1 || skipped "Node is not installed" "types and behaviour"
node -e 'process.exit(process.versions.node.split(".")[0] < 18 ? 1 : 0)' ||
    skipped "Node $(node --version) is older than 18" "types and behaviour"

cd "$(dirname "$0")/../tests/js"
# Each file is a process of its own, because some replace parts of the browser.
if ! report=$(node --test */*.test.js 2>&1); then
    echo "$report"
    exit 1
fi
echo "The page's JavaScript: $(echo "$report" | sed -n 's/^[#ℹ] pass //p') tests passed."
command -v npm >/dev/null 2>&1 || skipped "npm is not installed" "types"
fetched
npm run --silent types
if ! report=$(npm run --silent formatted 2>&1); then
    echo "$report"
    echo "static/js is not formatted: cd tests/js && npm run format"
    exit 1
fi
cd ../../tools/page_types
fetched
if ! report=$(npm run --silent check 2>&1); then
    echo "$report"
    echo "static/js/core/openapi.d.ts does not match the API's schema: cd tools/page_types && npm run write"
    exit 1
fi
echo "The page's JavaScript: types are sound, and those of the API are current."
