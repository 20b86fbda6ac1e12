#!/bin/sh
# Types and unit tests of the page's JavaScript. Node is not needed to use Unghost, so
# a machine without it is told and goes on.
set -eu

skipped() {
    echo "$1: the page's JavaScript was not checked here."
    exit 0
}

command -v npm >/dev/null 2>&1 || skipped "Node is not installed"
node -e 'process.exit(process.versions.node.split(".")[0] < 18 ? 1 : 0)' ||
    skipped "Node $(node --version) is older than 18"

cd "$(dirname "$0")/../tests/js"
if [ ! node_modules/.package-lock.json -nt package-lock.json ]; then
    npm ci --no-audit --no-fund --loglevel=error || skipped "npm could not fetch its tools"
fi
npm run --silent types
if ! report=$(npm test --silent 2>&1); then
    echo "$report"
    exit 1
fi
echo "The page's JavaScript: types are sound, $(echo "$report" | sed -n 's/^[#ℹ] pass //p') tests passed."
