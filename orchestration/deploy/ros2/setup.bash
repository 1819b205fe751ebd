# Lets `ros2 launch flockslam flockslam.launch.py` find this package: source it behind the setup.bash of ROS.
_flockslam_prefix=$(builtin cd "$(dirname "${BASH_SOURCE[0]}")" >/dev/null && pwd)
case ":${AMENT_PREFIX_PATH:-}:" in
*":$_flockslam_prefix:"*) ;;
*) export AMENT_PREFIX_PATH="$_flockslam_prefix${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}" ;;
esac
unset _flockslam_prefix
