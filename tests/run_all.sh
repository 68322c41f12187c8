#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# run_all.sh: what `make test` runs. The core's tests; the Blender tests on the bpy wheel of .venv;
# the same inside a real `blender -b`, and the core's again in its Python and NumPy, where one is found:
# $BLENDER, `blender` on PATH, or the one that `make blender` has fetched; and, with the fetched one, a
# story in a window under Xvfb. The last line says what ran, what it gave, and what was skipped.
#   FEMORS_NEED_BLENDER=1   a missing real Blender is a failure (CI)
#   FEMORS_TEST_PACKAGE=1   `make test-package` runs too (CI): no Blender tests of the checkout in a real one,
#                           and no story in its window
#   FEMORS_JOBS=2           the core in that Blender's Python runs beside the first two (CI); shown after them
set -uo pipefail
cd "$(dirname "$0")/.." || exit 1
python=.venv/bin/python
work=$(mktemp -d)
trap 'kill -- "-$beside" 2>/dev/null; rm -rf "$work"' EXIT
limit=""
command -v timeout >/dev/null && limit="timeout --foreground -k 10 2400" # a hang must not last for ever
verdict="" failed=0 skipped=0 beside=""

# stage NAME COMMAND...: run pytest and keep its closing line
stage() {
  local name=$1
  shift
  printf '\n##### %s\n' "$name"
  $limit "$@" </dev/null 2>&1 | tee "$work/out"
  judge "$name" "${PIPESTATUS[0]}"
}

# begin COMMAND...: the same, in the background; `joined` shows it
begin() {
  set -m # without it a background job is deaf to Ctrl-C, which a test sends
  $limit "$@" </dev/null >"$work/beside" 2>&1 &
  beside=$!
  set +m
}

# joined NAME: wait for what was begun, show what it has said, keep its closing line
joined() {
  local code
  wait "$beside"
  code=$?
  printf '\n##### %s\n' "$1"
  tee "$work/out" <"$work/beside"
  judge "$1" "$code"
  beside=""
}

# judge NAME CODE: what a stage adds to the verdict, by its exit code and the closing line of $work/out
judge() {
  local name=$1 code=$2 result
  result=$(sed -n 's/^=* *\([0-9].* in [0-9.]*s\).*$/\1/p' "$work/out" | tail -n 1)
  if [ "$code" -ne 0 ]; then
    failed=1
    result="FAILED with exit code $code${result:+ ($result)}"
  fi
  [[ $result =~ ([0-9]+)\ skipped ]] && skipped=$((skipped + BASH_REMATCH[1]))
  verdict+="$name: ${result:-passed}; "
}

# story: a morph as a person does it, in the fetched Blender's window; needs Xvfb, which came with it
story() {
  local site code
  if [ -n "${FEMORS_TEST_PACKAGE:-}" ]; then
    verdict+="left out: window with the checkout, for 'make test-package' shows the zip in two; "
    return
  fi
  if [ ! -x "$fetched" ] || [ ! -x "$runner" ]; then
    verdict+="SKIPPED: window, for no Blender with Xvfb was fetched ('make blender'); "
    return
  fi
  printf '\n##### window\n'
  if ! site=$(tests/prepare_blender.sh "$fetched"); then
    failed=1 verdict+="window: FAILED, $fetched could not be prepared; "
    return
  fi
  $limit "$runner" python3 tests/window/run_window.py --out test_output/window --site "$site" </dev/null 2>&1 | tee "$work/out"
  code=${PIPESTATUS[0]}
  case $code in
    0) verdict+="window: passed in $(tail -n 1 "$work/out"); " ;;
    5) verdict+="SKIPPED: window ($(sed -n 's/^skipped: //p' "$work/out")); " ;;
    *) failed=1 verdict+="window: FAILED with exit code $code, see test_output/window; " ;;
  esac
}

blender=${BLENDER:-$(command -v blender || true)}
fetched=${FEMORS_BLENDER_DIR:-$HOME/.cache/femors/blender}/blender-trixie
runner=${fetched%/*}/run-trixie
[ -n "$blender" ] || [ ! -x "$fetched" ] || blender=$fetched

# own: an environment with preferences of its own, for the command that follows
own() { echo "BLENDER_USER_RESOURCES=$(mktemp -d "$work/user-XXXX")"; }

site="" name="core in that Blender's Python"
[ -z "$blender" ] || site=$(tests/prepare_blender.sh "$blender")
inside=(env FEMORS_SITE="$site" "$blender" -b --factory-startup --python-exit-code 1 --python tests/run_in_blender.py --)
[ -z "$site" ] || [ "${FEMORS_JOBS:-1}" -le 1 ] || begin env "$(own)" "${inside[@]}" tests/test_*.py

stage "core" "$python" -m pytest
stage "bpy wheel" env "$(own)" "$python" -m pytest tests/blender

if [ -z "$blender" ]; then
  verdict+="SKIPPED: blender -b, for no blender was found ('make blender' fetches one, BLENDER=... names one); "
  [ -z "${FEMORS_NEED_BLENDER:-}" ] || failed=1
elif [ -n "$site" ]; then
  if [ -n "${FEMORS_TEST_PACKAGE:-}" ]; then
    verdict+="left out: blender -b with the checkout, for 'make test-package' does it with the zip; "
  else
    version=$("$blender" --version 2>/dev/null </dev/null | head -n 1)
    stage "blender -b ($version)" env "$(own)" "${inside[@]}" tests/blender
  fi
  if [ -n "$beside" ]; then joined "$name"; else stage "$name" env "$(own)" "${inside[@]}" tests/test_*.py; fi
else
  failed=1
  verdict+="blender -b ($blender): FAILED, it could not be prepared; "
fi
story

if [ "$skipped" -gt 0 ]; then
  verdict+="$skipped single test(s) skipped, for the reasons above"
else
  verdict+="no single test was skipped"
fi
[ -d "${FEMORS_DATA:-../shared/data}" ] || verdict+="; without ../shared/data, so the tests on real anatomy were skipped"
printf '\nmake test: %s\n' "$verdict"
exit $failed
