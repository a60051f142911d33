using UnityEngine;

namespace MrNav.Unity
{
    /// <summary>
    /// Says where the operator's fingertip is. Derive from it for your headset's hand tracking: MRTK, OpenXR hands,
    /// a controller's grip.
    /// </summary>
    public abstract class HandSource : MonoBehaviour
    {
        /// <summary>The newest pose, in metres in the world's axes; call it once a frame.</summary>
        public abstract HandPose Pose();
    }
}
