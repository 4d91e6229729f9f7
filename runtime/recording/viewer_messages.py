"""ROS 2 definitions of the messages that viewers know, as common_interfaces and geometry2 have
them (fields and order; without their comments)."""

_SEPARATOR = "=" * 80 + "\n"
_TIME = "int32 sec\nuint32 nanosec\n"
_PARTS = {
    "builtin_interfaces/Time": _TIME,
    "builtin_interfaces/Duration": _TIME,
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    "geometry_msgs/Pose": ("geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
    "geometry_msgs/Transform": (
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
    ),
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data\n",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v\n",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data\n",
    "visualization_msgs/Marker": (
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
        "builtin_interfaces/Duration lifetime\nbool frame_locked\n"
        "geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring texture_resource\n"
        "sensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\n"
        "string text\nstring mesh_resource\nvisualization_msgs/MeshFile mesh_file\n"
        "bool mesh_use_embedded_materials\n"
    ),
}
_GEOMETRY = ("geometry_msgs/Point", "geometry_msgs/Quaternion", "geometry_msgs/Vector3")
_HEADER = ("std_msgs/Header", "builtin_interfaces/Time")


def _with(own: str, *parts: str) -> str:
    """A definition followed by those of the types it is made of."""
    return own + "".join(f"{_SEPARATOR}MSG: {part}\n{_PARTS[part]}" for part in parts)


POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
JOINTS = "sensor_msgs/msg/JointState"
MARKERS = "visualization_msgs/msg/MarkerArray"

DEFINITIONS = {
    POSE: _with(
        "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
        *_HEADER,
        "geometry_msgs/Pose",
        *_GEOMETRY[:2],
    ),
    TRANSFORMS: _with(
        "geometry_msgs/TransformStamped[] transforms\n",
        "geometry_msgs/TransformStamped",
        *_HEADER,
        "geometry_msgs/Transform",
        *_GEOMETRY[1:],
    ),
    JOINTS: _with(
        "std_msgs/Header header\nstring[] name\n"
        "float64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        *_HEADER,
    ),
    MARKERS: _with(
        "visualization_msgs/Marker[] markers\n",
        "visualization_msgs/Marker",
        *_HEADER,
        "builtin_interfaces/Duration",
        "std_msgs/ColorRGBA",
        "geometry_msgs/Pose",
        *_GEOMETRY,
        "sensor_msgs/CompressedImage",
        "visualization_msgs/UVCoordinate",
        "visualization_msgs/MeshFile",
    ),
}
"""by message name"""
