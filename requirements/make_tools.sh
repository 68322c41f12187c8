#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# make_tools.sh FOLDER REQUIREMENTS PYTHON
#   Makes a virtual environment with what a file of requirements pins, unless it is there already. It is made
#   beside its place and renamed into it: one that was interrupted is never taken for a whole one, and of two
#   that are made at once the first is kept. Its programs are run as `FOLDER/bin/python -m PROGRAM`, for scripts
#   name the folder that they were made in.
set -euo pipefail
folder=$1 requirements=$2 python=$3
[ ! -e "$folder/.made" ] || exit 0
mkdir -p "$(dirname "$folder")"
new=$(mktemp -d "$(dirname "$folder")/.tools-XXXXXX")
trap 'rm -rf "$new"' EXIT
echo "installing $requirements into $folder"
"$python" -m venv "$new/venv"
"$new/venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-input -r "$requirements"
touch "$new/venv/.made"
for turn in 1 2 3 4 5 6 7 8 9; do
  # rename, and not mv, which would move it into the folder of a run that was faster
  "$new/venv/bin/python" -c 'import os, sys; os.rename(*sys.argv[1:])' "$new/venv" "$folder" 2>/dev/null && exit 0
  [ ! -e "$folder/.made" ] || exit 0
  # what stands there without the mark was begun before this script; it is moved out of the way, then removed.
  # Should a faster run have put a whole one there just now, ours takes its place the next turn
  mv "$folder" "$new/old$turn" 2>/dev/null || true
done
exit 1
