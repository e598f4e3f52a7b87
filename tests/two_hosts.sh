#!/usr/bin/env bash
# Server and client on two hosts of their own: network namespaces joined by a link with a rate limit (tc tbf) and
# a delay each way (tc netem where the kernel has it, else the delay proxy of tests/, between client and link). Run as root:
# tests/two_hosts.sh [RATE_MBIT] [DELAY_MS] [SECONDS] [OUT]; PROFILE=dev takes programs that are built
# already, SCENE another scene.
#
# It replays, kills the server in the middle, starts it again, and fails where the client did not come back or a
# frame was shown that is older than the link can explain.
set -euo pipefail

rate_mbit=${1:-20} delay_ms=${2:-10} seconds=${3:-12} out=${4:-$(mktemp -d)}
root=$(cd "$(dirname "$0")/.." && pwd)
target=${CARGO_TARGET_DIR:-$root/target}
profile=${PROFILE:-release}
if [ "$profile" = release ]; then
    cargo build --quiet --release --manifest-path "$root/Cargo.toml" -p warplight-server -p warplight-client
    cargo build --quiet --release --manifest-path "$root/Cargo.toml" -p warplight-tests --bin delay-proxy
    server=$target/release/warplight-server client=$target/release/warplight-client proxy=$target/release/delay-proxy
else
    server=$target/debug/server-under-test client=$target/debug/client-under-test proxy=$target/debug/delay-proxy
fi

tag=wl$$
server_host=${tag}s client_host=${tag}c
server_pid=
proxy_pid=
cleanup() {
    if [ -n "$server_pid" ]; then kill "$server_pid" 2>/dev/null || true; fi
    if [ -n "$proxy_pid" ]; then kill "$proxy_pid" 2>/dev/null || true; fi
    ip netns del "$server_host" 2>/dev/null || true
    ip netns del "$client_host" 2>/dev/null || true
}
trap cleanup EXIT

if ! ip netns add "$server_host" 2>/dev/null; then
    echo "two_hosts: skipped: network namespaces cannot be made here"
    exit 0
fi
ip netns add "$client_host"
ip link add "${tag}a" netns "$server_host" type veth peer name "${tag}b" netns "$client_host"
for end in "$server_host ${tag}a 10.77.0.1" "$client_host ${tag}b 10.77.0.2"; do
    read -r host device address <<<"$end"
    ip -n "$host" addr add "$address/24" dev "$device"
    ip -n "$host" link set "$device" up
    ip -n "$host" link set lo up
done
# The bottleneck is on the way down. Its queue holds 50 ms, as a router's would.
tc -n "$server_host" qdisc add dev "${tag}a" root handle 1: tbf rate "${rate_mbit}mbit" burst 32kb latency 50ms
address=10.77.0.1:7420
if tc -n "$client_host" qdisc add dev "${tag}b" root netem delay "${delay_ms}ms" 2>/dev/null &&
    tc -n "$server_host" qdisc add dev "${tag}a" parent 1: netem delay "${delay_ms}ms" 2>/dev/null; then
    echo "two_hosts: $rate_mbit Mbit/s down, netem delays by ${delay_ms} ms each way"
else
    tc -n "$client_host" qdisc del dev "${tag}b" root 2>/dev/null || true
    address=127.0.0.1:7421
    ip netns exec "$client_host" "$proxy" "$address" 10.77.0.1:7420 "$delay_ms" 2 >/dev/null 2>&1 &
    proxy_pid=$!
    echo "two_hosts: $rate_mbit Mbit/s down; this kernel has no netem, so a proxy delays by ${delay_ms} +- 2 ms each way"
fi

serve() {
    ip netns exec "$server_host" "$server" serve --scene "${SCENE:-gallery}" --listen 10.77.0.1:7420 \
        --insecure --threads 1 &
    server_pid=$!
}
serve
ip netns exec "$client_host" "$client" replay --connect "$address" --size 256x256 \
    --duration-s "$seconds" --quality-spp 4 --quality-every 240 --out "$out" &
client_pid=$!
sleep "$(( seconds / 2 ))"
echo "two_hosts: killing the server"
kill -9 "$server_pid"
wait "$server_pid" 2>/dev/null || true
sleep 1
serve
wait "$client_pid"

python3 - "$out/report.json" <<'EOF'
import json, sys
report = json.load(open(sys.argv[1]))
link, age = report["link"], report["latency_ms"]["frame_age"]
series = report["series"]["display"]["frame_age_ms"]
steady = [value for value in series[-60:] if value is not None]
stages = report["latency_ms"]["stages"]
print("two_hosts: " + ", ".join(f"{name} p50 {spread['p50']:.1f} ms" for name, spread in stages.items()))
print(f"two_hosts: {link['down_mbps']:.1f} Mbit/s, {link['frames_shown']} frames shown, {link['frames_replaced']} replaced, "
      f"{link['reconnects']} reconnect, frame age p50 {age['p50']:.0f} ms, at the end at most {max(steady):.0f} ms")
assert link["reconnects"] == 1, "the client did not come back exactly once"
assert link["frames_sent"] == link["frames_shown"] + link["frames_replaced"] + link["frames_lost"], "a frame is missing"
assert max(steady) < 1500, "delay grew"
EOF
