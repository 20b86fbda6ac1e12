#!/bin/sh
# Types and unit tests of the page's JavaScript. Node is not needed to use Unghost, so
# a machine without it is told and goes on.
set -eu

if ! command -v node >/dev/null 2>&1; then
    echo "Node is not installed: the page's JavaScript was not checked here."
    exit 0
fi
if ! node -e 'process.exit(Number(process.versions.node.split(".")[0]) < 20 ? 1 : 0)'; then
    echo "Node $(node --version) is older than 20: the page's JavaScript was not checked here."
    exit 0
fi

cd "$(dirname "$0")/../tests/js"
if [ ! -d node_modules ]; then
    npm install --no-audit --no-fund --silent
fi
npm run --silent check
npm test --silent
