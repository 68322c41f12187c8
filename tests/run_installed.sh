#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# run_installed.sh [BLENDER...]: what `make test-package` runs. Installs the zip of dist/ into each Blender
# as a user does, runs tests/blender against what is installed, takes SciPy away, uninstalls, and looks
# what is left; all with preferences of its own, and with nothing on the path but pytest. Debian's also show
# tests/window in a window under Xvfb; the pictures stay in test_output/window-trixie and -sid. A BLENDER is
#   trixie, sid    Debian's, as `make blender` fetched them (FEMORS_BLENDER_DIR)
#   4.5.15 ...     a bpy wheel, which is fetched into ~/.cache/femors (about 1.2 GB each)
#   /path/to/it    any binary
# Without any: those of $FEMORS_BLENDERS, else trixie, sid, and the wheels of 4.2 LTS, 4.5 LTS and 5.0.
# The last line says what ran, what it gave, and what was skipped.
#   FEMORS_NEED_BLENDER=1   a Blender that is not there is a failure (CI)
#   FEMORS_JOBS=2           that many Blenders at a time (CI); what they say is shown one after the other
set -uo pipefail
cd "$(dirname "$0")/.." || exit 1
# shellcheck disable=SC2206  # one word per Blender
[ $# -gt 0 ] || set -- ${FEMORS_BLENDERS:-trixie sid 4.2.23 4.5.15 5.0.1}
fetched=${FEMORS_BLENDER_DIR:-$HOME/.cache/femors/blender}
top=$(mktemp -d)
trap 'rm -rf "$top"' EXIT
jobs=${FEMORS_JOBS:-1}
limit=""
command -v timeout >/dev/null && limit="timeout --foreground -k 10" # a hang must not last for ever
export FEMORS_INSTALLED=1
unset PYTHONPATH

tell() { echo -n "$1; " >>"$work/verdict"; }
bad() {
  touch "$top/failed"
  tell "$blender: FAILED, $1"
  echo "FAILED: $blender: $1"
}

# the NumPy that each Blender ships, by the version of its wheel
numpy_of() { case $1 in 4.2.*) echo 1.24.3 ;; *) echo 1.26.4 ;; esac; }

# run SECONDS SCRIPT ARGUMENTS...: in the Blender of this round, started as a user starts it
run() {
  local seconds=$1 script=$2
  shift 2
  if [ -n "$binary" ]; then
    set -- "$binary" -b --python-exit-code 1 --python "$script" -- "$@"
  else
    set -- "$python" "$script" -- "$@"
  fi
  (cd "$work" && exec ${limit:+$limit $seconds} env FEMORS_SITE="$site" "$@" </dev/null 2>&1) | tee "$work/out"
  return "${PIPESTATUS[0]}"
}

# step NAME ARGUMENTS...: a step of installed/manage.py; its own word is waited for, and no traceback
step() {
  local code
  run 300 "$root/tests/installed/manage.py" "$@"
  code=$?
  if [ $code -ne 0 ] || ! grep -q "^femors-step $1: held" "$work/out" || grep -q Traceback "$work/out"; then
    bad "$1 did not hold (exit code $code)"
    return 1
  fi
}

# spoil WAY: take SciPy from the installed wheels, or make it one that cannot be loaded
spoil() {
  local scipy
  scipy=$(echo "$BLENDER_USER_RESOURCES"/extensions/.local/lib/*/site-packages/scipy)
  [ -d "$scipy" ] || { bad "no SciPy was unpacked to $scipy"; return 1; }
  case $1 in
    loading) echo 'raise ImportError("numpy.core.multiarray failed to import")' >"$scipy/__init__.py" ;;
    missing) rm -rf "$scipy" ;;
  esac
}

# window: a story in the window of a fetched Blender, with the package installed once more, in preferences of
# its own; stalls by a large mesh are measured in one Blender only
window() {
  local out=$root/test_output/window-$blender without="" code
  [ "$binary" = "$fetched/blender-$blender" ] && [ -x "$fetched/run-$blender" ] || return 0
  [ "$blender" = trixie ] || without=watched
  ${limit:+$limit 960} "$fetched/run-$blender" python3 "$root/tests/window/run_window.py" \
    --out "$out" --zip "$zip" --without "$without" </dev/null 2>&1 | tee "$work/out"
  code=${PIPESTATUS[0]}
  case $code in
    0) tell "$blender's window: held for $(tail -n 1 "$work/out")" ;;
    5) tell "SKIPPED: $blender's window ($(sed -n 's/^skipped: //p' "$work/out"))" ;;
    *) bad "the story in its window, with exit code $code, see $out" ;;
  esac
}

# round: everything in one Blender
round() {
  local start=$SECONDS result code
  export BLENDER_USER_RESOURCES=$work/user
  rm -rf "$BLENDER_USER_RESOURCES"
  mkdir "$BLENDER_USER_RESOURCES"
  if [ -n "$binary" ]; then # as `blender --command` does it
    "$binary" --command extension validate "$zip" </dev/null || { bad "the zip is not valid"; return; }
    "$binary" --command extension install-file -r user_default -e "$zip" </dev/null || { bad "it was not installed"; return; }
  else
    step install "$zip" || return
  fi
  step save "$work/saved.blend" || return
  run 1200 "$root/tests/run_in_blender.py" tests/blender
  code=$?
  result=$(sed -n 's/^=* *\([0-9].* in [0-9.]*s\).*$/\1/p' "$work/out" | tail -n 1)
  [ $code -eq 0 ] || bad "the tests, with exit code $code"
  window
  { spoil loading && step broken; } || return
  { spoil missing && step broken; } || return
  step uninstall || return
  step gone "$work/saved.blend" || return
  tell "$blender: ${result:-no result} of $((SECONDS - start)) s with installing and removing"
}

root=$PWD
version=$(sed -n 's/^version = "\(.*\)"/\1/p' blender_manifest.toml)

# prepare: what the Blender of this round needs, all of it kept for other runs; sets what `round` uses
prepare() {
  binary="" python="" end=linux-x64
  case $blender in
    [0-9]*) python=$(tests/prepare_bpy.sh "$blender" "$(numpy_of "$blender")") || { bad "its wheel could not be installed"; return 1; } ;;
    */*) binary=$blender ;;
    *) binary=$fetched/blender-$blender ;;
  esac
  if [ -n "$binary" ] && [ ! -x "$binary" ]; then
    if [ -n "${FEMORS_NEED_BLENDER:-}" ]; then bad "there is no $binary"; else
      tell "SKIPPED: $blender, there is no $binary ('make blender' fetches Debian's)"
    fi
    return 1
  fi
  site=$(tests/prepare_blender.sh --bare "${binary:-$python}") || { bad "the test tools could not be installed for it"; return 1; }
  [[ $site != */bare-3.14-* ]] || end=linux-x64-debian-test
  zip=$root/dist/femors-$version-$end.zip
  [ -f "$zip" ] || { bad "there is no $zip ('make package' builds it)"; return 1; }
}

number=0
for blender; do
  number=$((number + 1))
  work=$top/$number
  mkdir "$work"
  if ! prepare; then :; elif [ "$jobs" -le 1 ]; then
    printf '\n##### installed in %s\n' "$blender"
    round
  else
    while [ "$(jobs -rp | wc -l)" -ge "$jobs" ]; do wait -n; done
    echo "installing into $blender, and testing there"
    (printf '\n##### installed in %s\n' "$blender"; round) >"$work/log" 2>&1 </dev/null &
  fi
done
wait
for folder in "$top"/*/; do # a round that ends without a word has not passed
  [ -s "$folder/verdict" ] || { touch "$top/failed"; echo "FAILED: a round ended without a word" | tee "$folder/verdict"; }
done
cat "$top"/*/log 2>/dev/null
printf '\nmake test-package: %s\n' "$(cat "$top"/*/verdict 2>/dev/null)"
[ ! -e "$top/failed" ]
