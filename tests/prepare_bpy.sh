#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# prepare_bpy.sh VERSION NUMPY
#   Prints the Python of a virtual environment with that bpy wheel, the NumPy that this Blender ships,
#   and nothing that FEMORS needs. Made once, in ${FEMORS_CACHE:-~/.cache/femors}, with the Python 3.11
#   of .venv; all else that is said goes to stderr. About 375 MB to download and 1.2 GB installed, but
#   for the version that .venv has: that one's files get another (hard) link, and stay when .venv goes.
set -euo pipefail
[ $# -eq 2 ] || { echo "usage: $0 VERSION NUMPY" >&2; exit 2; }
cd "$(dirname "$0")/.."
version=$1 numpy=$2
cache=${FEMORS_CACHE:-$HOME/.cache/femors}
list=$(grep -v '^#' requirements/bpy_wheels.txt; echo "numpy==$numpy")
# the number: of this recipe, so that what another one made is not taken
folder=$cache/bpy-$version-$(cksum <<<"2 $list" | cut -d' ' -f1)
if [ ! -f "$folder/.complete" ]; then
  mkdir -p "$cache"
  exec 9>"$folder.lock" # two runs at once: the second waits, and finds it made
  flock 9 2>/dev/null || true
fi
if [ ! -f "$folder/.complete" ]; then
  echo "making $folder" >&2
  rm -rf "$folder"
  .venv/bin/python -m venv --without-pip "$folder"
  site=$folder/lib/python3.11/site-packages
  own=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("platlib"))')
  if [ -d "$own/bpy-$version.dist-info" ]; then
    cp -al "$own/bpy" "$site/bpy" 2>/dev/null || { rm -rf "$site/bpy"; cp -R "$own/bpy" "$site/bpy"; }
  else
    list+=$'\n'bpy==$version
  fi
  # shellcheck disable=SC2086  # one word per package
  .venv/bin/python -m pip --python "$folder/bin/python" install --quiet --disable-pip-version-check --no-input \
    --no-cache-dir --retries 10 --only-binary=:all: --no-deps $list >&2
  touch "$folder/.complete"
fi
echo "$folder/bin/python"
