using UnityEngine;

namespace MrNav.Unity
{
    /// <summary>Between Unity's vectors and the core's points; both in Unity's axes.</summary>
    internal static class Axes
    {
        public static Vector3 ToVector(this Point3 point)
        {
            return new Vector3((float)point.X, (float)point.Y, (float)point.Z);
        }

        public static Point3 ToPoint(this Vector3 vector)
        {
            return new Point3(vector.x, vector.y, vector.z);
        }
    }
}
