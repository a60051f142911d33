using UnityEngine;

namespace MrNav.Unity
{
    /// <summary>Moves a robot and a magnet in the scene as the real ones move, larger than life.</summary>
    public sealed class TwinView : MonoBehaviour
    {
        public RigConnection Rig;

        [Tooltip("How much larger than life the rig is shown.")]
        public float Scale = 20.0f;

        [Tooltip("The stage's point in µm that lies at this object's origin.")]
        public Vector3 OriginUm = new Vector3(10000.0f, 10000.0f, 0.0f);

        [Tooltip("Children of this object.")]
        public Transform Robot;

        public Transform Magnet;

        private void LateUpdate()
        {
            Twin twin = Rig.Twin;
            Place(Robot, twin == null ? null : twin.RobotUm);
            Place(Magnet, twin == null ? null : twin.TipUm);
        }

        /// <summary>What is not known is not shown: an old place would be a lie.</summary>
        private void Place(Transform shown, Point3? stageUm)
        {
            shown.gameObject.SetActive(stageUm.HasValue);
            if (stageUm.HasValue)
            {
                Point3 local = stageUm.Value - OriginUm.ToPoint();
                shown.localPosition = Frames.UnityFromStage(local, Scale).ToVector();
            }
        }
    }
}
