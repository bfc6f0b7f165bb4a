# Finds the Python that .venv is made of, or says how this very machine gets one. Read by ./ssp.
ssp_versions=(3.12 3.11 3.13 3.14)

# The interpreter itself, not one of a virtual environment that happens to be active (which may be
# the very one that is about to be made anew). Fails unless the wheels of ROS exist for it.
base_python() {
  "$1" -c 'import sys
print(sys._base_executable)
wheels = sys.implementation.name == "cpython" and "t" not in sys.abiflags
sys.exit(not (wheels and (3, 11) <= sys.version_info[:2] <= (3, 14)))' 2>/dev/null
}

find_python() {
  local version candidate found
  if [[ -n "${SSP_PYTHON:-}" ]]; then
    if found=$(base_python "$SSP_PYTHON"); then
      echo "$found"
      return
    fi
    echo "ssp: SSP_PYTHON=$SSP_PYTHON is no CPython 3.11 to 3.14 (it says:" \
      "$("$SSP_PYTHON" --version 2>&1 | head -1)). Name another one, or unset SSP_PYTHON." >&2
    return 1
  fi
  # The full paths too: a shim of a version manager may stand before them and run nothing.
  for version in "${ssp_versions[@]}" ""; do
    for candidate in "python${version:-3}" {/usr,/usr/local}/bin/"python${version:-3}"; do
      if found=$(base_python "$candidate"); then
        echo "$found"
        return
      fi
    done
  done
  install_python && return
  return 1
}

# Installs what this system offers if it may; else prints the command that does.
install_python() {
  local system version offered="" sudo="" packages found
  system=$(. /etc/os-release 2>/dev/null && echo "${PRETTY_NAME:-}") || true
  found=$(python3 --version 2>/dev/null) || found="no python3"
  echo "ssp: no Python 3.11 to 3.14 found on ${system:-this machine}" \
    "(there is $found)." >&2
  if command -v apt-get >/dev/null; then
    if [[ $EUID -eq 0 ]]; then
      sudo="env"
    elif sudo -n true 2>/dev/null; then
      sudo="sudo -n"
    fi
    if [[ -n "$sudo" ]]; then
      $sudo apt-get update >/dev/null ||
        echo "ssp: apt-get update failed; what follows goes by older package lists" >&2
    elif ! apt_offers python3; then
      echo "Its package lists are empty. Run this, then ./ssp again, which says what they offer:" >&2
      echo "  $(as_root "apt-get update")" >&2
      return 1
    fi
    for version in "${ssp_versions[@]}"; do
      apt_offers "python$version" && offered=$version && break
    done
    packages="python$offered python$offered-venv python$offered-dev"
    if [[ -n "$offered" && -n "$sudo" ]]; then
      echo "ssp: installing $packages" >&2
      packages="apt-get install -y --no-install-recommends $packages"
      # shellcheck disable=SC2086
      if DEBIAN_FRONTEND=noninteractive $sudo $packages >/dev/null; then
        base_python "/usr/bin/python$offered" && return
      else
        echo "ssp: the installation failed. What this says must be mended, then ./ssp again:" >&2
        echo "  $(as_root "$packages")" >&2
        return 1
      fi
    elif [[ -n "$offered" ]]; then
      advise "apt-get install -y $packages"
      return 1
    fi
  elif command -v dnf >/dev/null; then
    for version in "${ssp_versions[@]}"; do
      if [[ -n "$(dnf -q repoquery --whatprovides "python$version" 2>/dev/null)" ]]; then
        advise "dnf install -y python$version python$version-devel"
        return 1
      fi
    done
  elif command -v zypper >/dev/null; then
    for version in "${ssp_versions[@]}"; do
      if zypper -nq search -x "python${version/./}" >/dev/null 2>&1; then
        advise "zypper install -y python${version/./} python${version/./}-devel"
        return 1
      fi
    done
  fi
  local get="curl -LsSf"
  command -v curl >/dev/null || get="wget -qO-"
  echo "This system's packages have none. uv brings one of its own, without root:" >&2
  if ! command -v curl >/dev/null && ! command -v wget >/dev/null; then
    get="curl -LsSf"
    if command -v apt-get >/dev/null; then
      echo "  $(as_root "apt-get install -y curl ca-certificates")" >&2
    else
      echo "  # first install curl, which this machine lacks" >&2
    fi
  fi
  echo "  $get https://astral.sh/uv/install.sh | sh" >&2
  echo "  ~/.local/bin/uv python install 3.13" >&2
  echo "  export SSP_PYTHON=\$(~/.local/bin/uv python find 3.13)      # then ./ssp again" >&2
  return 1
}

apt_offers() {
  [[ "$(apt-cache policy "$1" 2>/dev/null)" == *"Candidate: "[0-9]* ]]
}

advise() {
  echo "This system offers one. Run this, then ./ssp again:" >&2
  echo "  $(as_root "$1")" >&2
}

# The command as this user gives it here.
as_root() {
  if [[ $EUID -eq 0 ]]; then
    echo "$1"
  elif command -v sudo >/dev/null; then
    echo "sudo $1"
  else
    echo "su -c '$1'"
  fi
}
