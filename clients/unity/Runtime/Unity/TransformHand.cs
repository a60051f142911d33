using UnityEngine;

namespace MrNav.Unity
{
    /// <summary>A hand that follows a transform, for example a controller's; a key or button is its clutch.</summary>
    public sealed class TransformHand : HandSource
    {
        [Tooltip("Where the fingertip is.")]
        public Transform Fingertip;

        [Tooltip("The robot follows while this key or button is down.")]
        public KeyCode ClutchKey = KeyCode.C;

        public override HandPose Pose()
        {
            bool seen = Fingertip != null && Fingertip.gameObject.activeInHierarchy;
            Point3 position = seen ? Fingertip.position.ToPoint() : new Point3(0.0, 0.0, 0.0);
            return new HandPose(position, Input.GetKey(ClutchKey), seen);
        }
    }
}
