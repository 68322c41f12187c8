#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# make_venv.sh FOLDER [PYTHON]: makes or mends the virtual environment that `make setup` promises.
set -euo pipefail
folder=$1 wanted=${2:-}
cd "$(dirname "$0")/.."

is_311() { "$1" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null </dev/null; }

python=""
for candidate in ${wanted:-python3.11 python3}; do
  if is_311 "$candidate"; then python=$candidate; break; fi
done
if [ -z "$python" ]; then
  echo "make setup: Python 3.11 is needed, and ${wanted:-neither python3.11 nor python3} is not one." >&2
  echo "Install it (Debian 12: apt install python3.11-venv; elsewhere: uv python install 3.11, pyenv, python.org), or name it: make setup PYTHON=/path/to/python3.11" >&2
  exit 1
fi
if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
  echo "make setup: $python cannot make virtual environments; install its venv module (Debian: apt install python3.11-venv)." >&2
  exit 1
fi
if ! is_311 "$folder/bin/python"; then
  echo "making $folder with $("$python" --version)"
  "$python" -m venv --clear "$folder"
fi
echo "installing requirements/venv.txt into $folder (bpy is about 375 MB to download, 1.2 GB installed)"
"$folder/bin/python" -m pip install --quiet --disable-pip-version-check --no-input -r requirements/venv.txt || {
  echo "make setup: pip could not install requirements/venv.txt; the lines above say why (bpy has wheels for few systems, and needs a network)." >&2
  exit 1
}
# so that `python -m femors_addon` works from any folder
pwd -P >"$("$folder/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/femors.pth"
