# shellcheck shell=bash
# Source it, then call: bootstrap [EXTRA]. Makes ROOT/.venv fit pyproject.toml and constraints.txt.
# Sets ROOT (the repository) and PYTHON (its interpreter); says in one line what the system lacks.

ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
PYTHON=$ROOT/.venv/bin/python

fail() {
  printf '%s\n' "$1" >&2
  exit 1
}

# Prints the first Python of at least 3.11.
find_python() {
  local name
  for name in python3 python3.13 python3.12 python3.11; do
    if "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
      printf '%s\n' "$name"
      return
    fi
  done
  fail "bootstrap: Python 3.11 or newer is missing: sudo apt-get install python3"
}

fingerprint() {
  { cat "$ROOT/pyproject.toml" "$ROOT/constraints.txt"; printf '%s' "$ROOT"; } | sha256sum | cut -d ' ' -f 1
}

make_venv() {
  local python
  python=$(find_python) || exit 1
  "$python" -c 'import ensurepip, venv' 2>/dev/null ||
    fail "bootstrap: the package python3-venv is missing: sudo apt-get install python3-venv"
  rm -rf "$ROOT/.venv"
  "$python" -m venv "$ROOT/.venv" || fail "bootstrap: $python -m venv failed (see above)"
}

bootstrap() {
  local extra=${1:-} wanted stamp lock # an installation with extras serves as one without
  wanted=$(fingerprint)
  stamp=$ROOT/.venv/installed${extra:+-$extra}
  exec {lock}<"$ROOT" # two at a time would spoil each other's packages
  flock "$lock"
  if [ ! -x "$PYTHON" ] || ! grep -qsFx "$wanted" "$stamp"*; then
    [ -x "$PYTHON" ] || make_venv
    echo "bootstrap: installing into .venv (some minutes the first time)"
    if ! "$PYTHON" -m pip install --quiet --disable-pip-version-check \
      --constraint "$ROOT/constraints.txt" --editable "$ROOT${extra:+[$extra]}" >"$ROOT/.venv/pip.log" 2>&1; then
      tail -n 20 "$ROOT/.venv/pip.log" >&2
      fail "bootstrap: pip failed (see above); mend that, or the network, and run the same command again"
    fi
    printf '%s\n' "$wanted" >"$stamp"
  fi
  exec {lock}<&-
}
