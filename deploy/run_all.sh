#!/usr/bin/env bash
# Starts, shows, inspects and stops a cell; `deploy/run_all.sh --help` says how. Works from any directory.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/bootstrap.sh"
bootstrap
exec "$PYTHON" -m deploy.main "$@"
