#!/usr/bin/env bash
# Makes the Debian package of flockslam, and one with its symbols:
#
#     orchestration/deploy/package.sh [--out DIR]                    builds with the profile `dist`; needs dpkg-deb, objcopy, python3
#     orchestration/deploy/package.sh --arch arm64 [--out DIR]       the same for processors of 64-bit ARM, built on any machine
#     orchestration/deploy/package.sh --arch arm64 --build PROFILE   only builds the executable, and prints its path
#     orchestration/deploy/package.sh --stage DIR --executable FILE  only lays out the files, with an executable that is there
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
out=$root/target/package
stage=
executable=
profile=
architecture=
while (($#)); do
    case $1 in
    --out) out=$2 ;;
    --stage) stage=$2 ;;
    --executable) executable=$2 ;;
    --arch) architecture=$2 ;;
    --build) profile=$2 ;;
    *)
        echo "package.sh: $1: not an option; known are --arch, --build, --out, --stage, --executable" >&2
        exit 2
        ;;
    esac
    shift 2
done
version=$(sed -n 's/^version = "\(.*\)"/\1/p' "$root/Cargo.toml" | head -1)
# A glibc of this version has every symbol that is used.
glibc_max=2.35
package_max_bytes=$((25 << 20))
# Exit code where a tool for the architecture is missing.
cannot_be_built=3

# The machine's own architecture, unless another is asked for.
case $(uname -m) in
aarch64) own=arm64 ;;
*) own=amd64 ;;
esac
architecture=${architecture:-$own}
case $architecture in
amd64) processor=x86_64 ;;
arm64) processor=aarch64 ;;
*)
    echo "package.sh: --arch $architecture: known are amd64 and arm64" >&2
    exit 2
    ;;
esac
triple=$processor-unknown-linux-gnu
prefix=
# Runs the executable, which makes its own manuals.
emulator=()
if [[ $architecture != "$own" ]]; then
    prefix=$processor-linux-gnu-
    emulator=("qemu-$processor")
    # The libraries of the cross compiler, unless there are those of the system: the two do not mix.
    [[ -e /lib/ld-linux-$processor.so.1 ]] || emulator+=(-L "/usr/$processor-linux-gnu")
fi

# Builds with a profile for the architecture; `executable` is then its path.
build() {
    local profile=$1 folder=$1 candidate library compiler= missing=()
    [[ $profile == dev ]] && folder=debug
    cd "$root"
    if [[ -z $prefix ]]; then
        cargo build --profile "$profile" -p flockslam
        executable=$root/target/$folder/flockslam
        return
    fi
    # A compiler that has the standard library for it: rustup's, or Debian's.
    for candidate in "${RUSTC:-rustc}" /usr/bin/rustc; do
        library=$("$candidate" --print target-libdir --target "$triple" 2>/dev/null) || continue
        if compgen -G "$library/libstd-*" >/dev/null; then
            compiler=$candidate
            break
        fi
    done
    [[ -n $compiler ]] || missing+=("the standard library of Rust for $triple (rustup target add $triple, or of Debian 12 rustc-web and libstd-rust-web-dev:$architecture)")
    command -v "${prefix}gcc" >/dev/null || missing+=("${prefix}gcc (gcc-$processor-linux-gnu, libc6-dev-$architecture-cross)")
    command -v "${emulator[0]}" >/dev/null || missing+=("${emulator[0]} (qemu-user)")
    if ((${#missing[@]})); then
        missing=("$(printf '; %s' "${missing[@]}")")
        echo "package.sh: $architecture cannot be built here, missing: ${missing[0]:2}" >&2
        exit "$cannot_be_built"
    fi
    local name=${triple//-/_}
    export "CC_$name=${prefix}gcc" "AR_$name=${prefix}ar" "CARGO_TARGET_${name^^}_LINKER=${prefix}gcc"
    RUSTC=$compiler cargo build --profile "$profile" -p flockslam --target "$triple"
    executable=$root/target/$triple/$folder/flockslam
}

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
    # As they lie in the repository: they link to each other.
    for file in README.md ARCHITECTURE.md CHANGELOG.md CONTRIBUTING.md dashboards/README.md; do put 0644 "$root/$file" "$doc/$file"; done
    for file in "$root"/docs/*.md; do put 0644 "$file" "$doc/docs/$(basename "$file")"; done
    put 0644 "$root/LICENSE-MIT" "$doc/LICENSE-MIT"
    put 0644 "$root/LICENSE-APACHE" "$doc/LICENSE-APACHE"
    put 0644 "$here/package/copyright" "$doc/copyright"
    python3 "$here/package/licences.py" "$root" "$triple" >"$tree/$doc/third-party-licences.txt"
    gzip -n -9 "$tree/$doc/third-party-licences.txt"

    # Man pages and completions.
    local manuals
    manuals=$(mktemp -d)
    "${emulator[@]}" "$program" manuals --out "$manuals"
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
Architecture: $architecture
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

if [[ -n $profile ]]; then
    build "$profile"
    echo "$executable"
    exit
fi
[[ -n $executable ]] || build dist
cd "$root"
newest=$("${prefix}objdump" -T "$executable" | grep -o 'GLIBC_[0-9.]*' | sort -uV | tail -1)
if [[ $(printf '%s\n' "GLIBC_$glibc_max" "$newest" | sort -V | tail -1) != "GLIBC_$glibc_max" ]]; then
    echo "package.sh: a symbol of $newest is used, $glibc_max is the newest that may be" >&2
    exit 1
fi
mkdir -p "$out"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${prefix}objcopy" --only-keep-debug "$executable" "$work/flockslam.debug"
"${prefix}objcopy" --strip-all --add-gnu-debuglink="$work/flockslam.debug" "$executable" "$work/flockslam"
lay_out "$work/flockslam" "$work/tree"
control
deb=$out/flockslam_${version}_$architecture.deb
dpkg-deb --root-owner-group -Zxz --build "$work/tree" "$deb" >/dev/null

tree=$work/symbols
put 0644 "$work/flockslam.debug" usr/lib/debug/usr/bin/flockslam.debug
install -d -m 0755 "$tree/DEBIAN"
cat >"$tree/DEBIAN/control" <<END
Package: flockslam-dbg
Version: $version
Architecture: $architecture
Maintainer: flockslam developers <flockslam@localhost>
Section: debug
Priority: optional
Depends: flockslam (= $version)
Description: symbols of flockslam, for debuggers and profilers
END
dpkg-deb --root-owner-group -Zxz --build "$tree" "$out/flockslam-dbg_${version}_$architecture.deb" >/dev/null

bytes=$(stat -c %s "$deb")
if ((bytes > package_max_bytes)); then
    echo "package.sh: the package has $bytes bytes, more than $package_max_bytes" >&2
    exit 1
fi
ls -l "$out"/*.deb
