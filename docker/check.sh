#!/bin/sh
# Does the whole job on a simulated city with the `tiler` of the PATH; what it writes is removed again.
# It also fills the kernels' compile cache (NUMBA_CACHE_DIR), so that the image starts warm.
set -eu

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

tiler --version
tiler demo -o "$work/demo" "$@"
test -s "$work/demo/dtm.tif"
tiler info "$work/demo/dtm.tif"
