#!/usr/bin/env bash
# Everything that must hold before a change lands: style, types, import contracts, tests. Works from any directory.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/../deploy/bootstrap.sh"

step() {
  local name=$1 begin=$SECONDS
  shift
  printf '== %s\n' "$name"
  "$@" || fail "== $name: FAILED after $((SECONDS - begin)) s"
  printf '== %s: ok, %d s\n' "$name" "$((SECONDS - begin))"
}

step bootstrap bootstrap dev
cd "$ROOT"
export PATH=$ROOT/.venv/bin:$PATH
step 'ruff check' ruff check
step 'ruff format' ruff format --check
step pyright pyright
step 'import contracts' lint-imports
step pytest pytest "$@"
