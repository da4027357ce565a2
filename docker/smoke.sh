#!/bin/bash
# Does in a clean environment what the image and the compose file do, where no container engine runs:
# the same files (COPY of the Dockerfile), the same installation (install.sh), the same variables (ENV),
# the same check (check.sh), and the compose file's scheduler and workers on local ports.
# Usage: docker/smoke.sh   (from the repository's root; needs python3 >= 3.11 and a package index)
set -euo pipefail

work=$(mktemp -d)
cluster=()
finish() {
    for process in "${cluster[@]}"; do
        kill "$process" 2>/dev/null || true
        wait "$process" 2>/dev/null || true
    done
    rm -rf "$work"
}
trap finish EXIT

echo "smoke: the Dockerfile's files"
mkdir -p "$work/src" "$work/home" "$work/cache" "$work/out"
sed -n 's/^COPY \([^-].*\) \/src.*$/\1/p' docker/Dockerfile | tr ' ' '\n' | while read -r name; do
    cp -R "$name" "$work/src/"
done

# Nothing of this shell but what an image has too, and what the package client needs to reach its index.
clean=("HOME=$work/home" "LANG=C.UTF-8" "TMPDIR=${TMPDIR:-/tmp}")
while IFS= read -r variable; do
    clean+=("$variable")
done < <(env | grep -E '^(PIP_|SSL_CERT|REQUESTS_CA|https?_proxy|HTTPS?_PROXY|no_proxy|NO_PROXY)' || true)
path="$(dirname "$(python3 -c 'import os, sys; print(os.path.realpath(sys.executable))')"):/usr/local/bin:/usr/bin:/bin"

echo "smoke: the image's installation"
(cd "$work/src" && env -i "${clean[@]}" "PATH=$path" docker/install.sh "$work/tiler")

while IFS='=' read -r name value; do
    value=${value//\$PATH/$path}
    value=${value//\/opt\/tiler/$work/tiler}
    value=${value//\/var\/cache\/tiler/$work/cache}
    clean+=("$name=$value")
done < <(sed -n 's/^ENV //p' docker/Dockerfile)

echo "smoke: the image's check"
cd "$work/out"
env -i "${clean[@]}" "$work/src/docker/check.sh"

echo "smoke: the compose file's cluster"
# Dask imports from its temporary folder: it must be one that no other user can write into.
clean+=("DASK_TEMPORARY_DIRECTORY=$work")
# A port below those that the system gives to whoever asks for any.
port=$(python3 -c 'import random, socket
for port in random.sample(range(20000, 32000), 100):
    try:
        socket.socket().bind(("127.0.0.1", port))
    except OSError:
        continue
    print(port)
    break')
env -i "${clean[@]}" dask scheduler --host 127.0.0.1 --port "$port" --no-dashboard >"$work/scheduler.log" 2>&1 &
cluster+=($!)
env -i "${clean[@]}" dask worker "tcp://127.0.0.1:$port" --nworkers 2 --nthreads 1 --memory-limit 0 --no-dashboard \
    >"$work/workers.log" 2>&1 &
cluster+=($!)
env -i "${clean[@]}" python -c "from distributed import Client; Client('tcp://127.0.0.1:$port', timeout=600).wait_for_workers(2, 600)"
env -i "${clean[@]}" "$work/src/docker/check.sh" --scheduler "tcp://127.0.0.1:$port"
echo "smoke: done"
