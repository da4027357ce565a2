#!/bin/sh
# Installs tiler of the current folder into a new environment, with the locked versions and nothing else.
# The image and the smoke test both call it, so that what is tested is what is shipped.
# Usage: docker/install.sh PREFIX
set -eu

prefix=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

python3 -m venv "$work/build"
"$work/build/bin/pip" install --quiet --no-deps -r docker/build.lock
"$work/build/bin/pip" wheel --quiet --no-deps --no-build-isolation --wheel-dir "$work/wheel" .

python3 -m venv "$prefix"
"$prefix/bin/pip" install --quiet --no-deps --only-binary :all: -r docker/requirements.lock
"$prefix/bin/pip" install --quiet --no-deps "$work"/wheel/tiler_dtm-*.whl
"$prefix/bin/pip" check
