#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# prepare_blender.sh [--bare] BLENDER
#   Prints a folder with what the tests need in that Blender's Python (pytest, SciPy,
#   fast-simplification; --bare: pytest only), for FEMORS_SITE of tests/run_in_blender.py. BLENDER may
#   be the Python of a bpy wheel. Made once per Python version with the pip of .venv, in
#   ${FEMORS_CACHE:-~/.cache/femors}; all else that is said goes to stderr.
set -euo pipefail
kind=site
[ "${1:-}" != --bare ] || { kind=bare; shift; }
[ $# -eq 1 ] || { echo "usage: $0 [--bare] BLENDER" >&2; exit 2; }
root=$(cd "$(dirname "$0")/.." && pwd -P)
cache=${FEMORS_CACHE:-$HOME/.cache/femors}

resources=$(mktemp -d)
trap 'rm -rf "$resources"' EXIT
ask='import sys; print("\nfemors-python %d.%d" % sys.version_info[:2])'
case ${1##*/} in
  python*) said=$("$1" -c "$ask" </dev/null 2>&1) ;;
  *) said=$(BLENDER_USER_RESOURCES=$resources "$1" -b --factory-startup --python-exit-code 1 --python-expr "$ask" </dev/null 2>&1) ;;
esac ||
  { echo "$said" >&2; echo "$1: does not start" >&2; exit 1; }
python=$(sed -n 's/^femors-python //p' <<<"$said")
case $python in
  3.11 | 3.12 | 3.13) scipy=1.15.3 ;; # one pin for the official Blender 4.2 to 5.2
  3.14) scipy=1.18.1 ;;
  *) echo "$1: no SciPy is chosen for its Python '$python'; add one in $0" >&2; exit 1 ;;
esac

list=$(grep -v '^#' "$root/requirements/blender_tests.txt")
[ $kind = bare ] || list+=$'\n'$(grep -v '^#' "$root/requirements/blender.txt"; echo "scipy==$scipy")
site=$cache/$kind-$python-$(cksum <<<"$list" | cut -d' ' -f1)
if [ ! -d "$site" ]; then
  echo "installing the test tools for Python $python into $site" >&2
  mkdir -p "$cache"
  new=$(mktemp -d "$cache/.site-XXXXXX")
  trap 'rm -rf "$resources" "$new"' EXIT
  # shellcheck disable=SC2086  # one word per package
  "$root/.venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-input --target "$new/site" \
    --python-version "$python" --ignore-requires-python --retries 10 --only-binary=:all: --no-deps $list >&2
  # rename, and not mv, which would move it into the folder of a run that was faster
  "$root/.venv/bin/python" -c 'import os, sys; os.rename(*sys.argv[1:])' "$new/site" "$site" 2>/dev/null || [ -d "$site" ]
fi
echo "$site"
