#!/usr/bin/env bash
# Makes the Debian package of flockslam, and one with its symbols:
#
#     orchestration/deploy/package.sh [--out DIR]                    builds with the profile `dist`; needs dpkg-deb, objcopy, python3
#     orchestration/deploy/package.sh --stage DIR --executable FILE  only lays out the files, with an executable that is there
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
out=$root/target/package
stage=
executable=
while (($#)); do
    case $1 in
    --out) out=$2 ;;
    --stage) stage=$2 ;;
    --executable) executable=$2 ;;
    *)
        echo "package.sh: $1: not an option; known are --out, --stage, --executable" >&2
        exit 2
        ;;
    esac
    shift 2
done
version=$(sed -n 's/^version = "\(.*\)"/\1/p' "$root/Cargo.toml" | head -1)
# A glibc of this version has every symbol that is used.
glibc_max=2.35
package_max_bytes=$((25 << 20))

put() { install -D -m "$1" "$2" "$tree/$3"; }

# All files but the executable's symbols. $1: executable, $2: tree.
lay_out() {
    local program=$1
    tree=$2
    put 0755 "$program" usr/bin/flockslam
    put 0644 "$here/flockslam@.service" usr/lib/systemd/system/flockslam@.service
    put 0644 "$here/package/60-flockslam-lidars.rules" usr/lib/udev/rules.d/60-flockslam-lidars.rules
    put 0644 "$here/package/60-flockslam.conf" usr/lib/sysctl.d/60-flockslam.conf

    # Examples, dashboards, documentation.
    local doc=usr/share/doc/flockslam file
    for file in "$here"/*.toml; do put 0644 "$file" "$doc/examples/$(basename "$file")"; done
    (cd "$root/dashboards" && find . -path ./page -prune -o -type f -print) | while read -r file; do
        put 0644 "$root/dashboards/$file" "usr/share/flockslam/dashboards/${file#./}"
    done
    for file in "$root"/docs/*.md "$root/README.md"; do put 0644 "$file" "$doc/$(basename "$file")"; done
    put 0644 "$root/LICENSE-MIT" "$doc/LICENSE-MIT"
    put 0644 "$root/LICENSE-APACHE" "$doc/LICENSE-APACHE"
    put 0644 "$here/package/copyright" "$doc/copyright"
    python3 "$here/package/licences.py" "$root" >"$tree/$doc/third-party-licences.txt"
    gzip -n -9 "$tree/$doc/third-party-licences.txt"

    # Man pages and completions.
    local manuals
    manuals=$(mktemp -d)
    "$program" manuals --out "$manuals"
    for file in "$manuals"/man1/*; do
        put 0644 "$file" "usr/share/man/man1/$(basename "$file")"
        gzip -n -9 "$tree/usr/share/man/man1/$(basename "$file")"
    done
    put 0644 "$manuals/completions/flockslam.bash" usr/share/bash-completion/completions/flockslam
    put 0644 "$manuals/completions/_flockslam" usr/share/zsh/vendor-completions/_flockslam
    put 0644 "$manuals/completions/flockslam.fish" usr/share/fish/vendor_completions.d/flockslam.fish
    rm -rf "$manuals"

    # The same as a package of ROS 2, below a prefix of its own.
    local prefix=opt/flockslam share=opt/flockslam/share/flockslam
    install -d "$tree/$prefix/lib/flockslam" "$tree/$share"
    ln -s /usr/bin/flockslam "$tree/$prefix/lib/flockslam/flockslam"
    sed "s/@VERSION@/$version/" "$here/ros2/package.xml" >"$tree/$share/package.xml"
    chmod 0644 "$tree/$share/package.xml"
    put 0644 "$here/ros2/flockslam.launch.py" "$share/launch/flockslam.launch.py"
    for file in robot.toml parameters.yaml nav2.yaml; do put 0644 "$here/ros2/$file" "$share/config/$file"; done
    put 0644 /dev/null "$prefix/share/ament_index/resource_index/packages/flockslam"
    put 0644 "$here/ros2/setup.bash" "$prefix/setup.bash"
    put 0644 "$here/ros2/parameters.yaml" etc/flockslam/ros2/parameters.yaml
}

control() {
    install -d -m 0755 "$tree/DEBIAN"
    cat >"$tree/DEBIAN/control" <<END
Package: flockslam
Version: $version
Architecture: amd64
Maintainer: flockslam developers <flockslam@localhost>
Section: science
Priority: optional
Depends: libc6 (>= $glibc_max), libgcc-s1, passwd
Recommends: udev, systemd
Installed-Size: $(du -sk "$tree" | cut -f1)
Description: 2-D lidar SLAM for one robot or a flock of them
 Turns scans of a 2-D lidar into a map, a trajectory and a pose for every scan.
 "flockslam setup" finds the lidar and makes a service, "flockslam doctor"
 says what is wrong. It joins a ROS 2 graph without an installation of ROS.
END
    echo /etc/flockslam/ros2/parameters.yaml >"$tree/DEBIAN/conffiles"
    install -m 0755 "$here/package/postinst" "$here/package/prerm" "$here/package/postrm" "$tree/DEBIAN"
}

if [[ -n $stage ]]; then
    [[ -n $executable ]] || { echo "package.sh: --stage needs --executable FILE" >&2; exit 2; }
    lay_out "$executable" "$stage"
    exit
fi

cd "$root"
if [[ -z $executable ]]; then
    cargo build --profile dist -p flockslam
    executable=$root/target/dist/flockslam
fi
newest=$(objdump -T "$executable" | grep -o 'GLIBC_[0-9.]*' | sort -uV | tail -1)
if [[ $(printf '%s\n' "GLIBC_$glibc_max" "$newest" | sort -V | tail -1) != "GLIBC_$glibc_max" ]]; then
    echo "package.sh: a symbol of $newest is used, $glibc_max is the newest that may be" >&2
    exit 1
fi
mkdir -p "$out"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
objcopy --only-keep-debug "$executable" "$work/flockslam.debug"
objcopy --strip-all --add-gnu-debuglink="$work/flockslam.debug" "$executable" "$work/flockslam"
lay_out "$work/flockslam" "$work/tree"
control
deb=$out/flockslam_${version}_amd64.deb
dpkg-deb --root-owner-group -Zxz --build "$work/tree" "$deb" >/dev/null

tree=$work/symbols
put 0644 "$work/flockslam.debug" usr/lib/debug/usr/bin/flockslam.debug
install -d -m 0755 "$tree/DEBIAN"
cat >"$tree/DEBIAN/control" <<END
Package: flockslam-dbg
Version: $version
Architecture: amd64
Maintainer: flockslam developers <flockslam@localhost>
Section: debug
Priority: optional
Depends: flockslam (= $version)
Description: symbols of flockslam, for debuggers and profilers
END
dpkg-deb --root-owner-group -Zxz --build "$tree" "$out/flockslam-dbg_${version}_amd64.deb" >/dev/null

bytes=$(stat -c %s "$deb")
if ((bytes > package_max_bytes)); then
    echo "package.sh: the package has $bytes bytes, more than $package_max_bytes" >&2
    exit 1
fi
ls -l "$out"/*.deb
