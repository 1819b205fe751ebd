"""Prints the licence texts of everything that is linked into the executable: licences.py ROOT TARGET.

Takes what cargo knows of the dependencies on the target, without those of tests. Texts that are the same are printed once.
"""
import json
import pathlib
import subprocess
import sys

NAMES = ("licen", "copying", "notice", "unlicense")


def reachable(metadata):
    """Packages that the executable is made of: normal dependencies, from the workspace's members on."""
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    roots = [package["id"] for package in metadata["packages"] if package["name"] == "flockslam"]
    seen, waiting = set(), roots
    while waiting:
        package = waiting.pop()
        if package in seen:
            continue
        seen.add(package)
        for dependency in nodes[package]["deps"]:
            if any(kind["kind"] is None for kind in dependency["dep_kinds"]):
                waiting.append(dependency["pkg"])
    return seen


def texts(package):
    """Licence files of a package."""
    folder = pathlib.Path(package["manifest_path"]).parent
    named = [folder / package["license_file"]] if package.get("license_file") else []
    found = sorted(path for path in folder.iterdir() if path.name.lower().startswith(NAMES) and path.is_file())
    return [path.read_text(errors="replace").strip() for path in dict.fromkeys(named + found) if path.is_file()]


def main():
    root, target = sys.argv[1:]
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--offline", "--filter-platform", target]
    metadata = json.loads(subprocess.run(command, cwd=root, check=True, capture_output=True).stdout)
    inside = reachable(metadata)
    by_text, without = {}, []
    for package in sorted(metadata["packages"], key=lambda package: (package["name"], package["version"])):
        if package["id"] not in inside or package["source"] is None:
            continue
        name = f"{package['name']} {package['version']} ({package['license'] or 'see below'})"
        own = texts(package)
        if not own:
            without.append(f"{name} {' '.join(package['authors'])}".strip())
        for text in own:
            by_text.setdefault(text, []).append(name)
    for text, names in by_text.items():
        print("=" * 100, *names, "-" * 100, text, sep="\n", end="\n\n")
    print("=" * 100)
    print("Without a text of their own; the texts of the named licences stand above or in common-licenses:", *without, sep="\n")


main()
