using UnityEngine;

namespace MrNav.Unity
{
    /// <summary>Writes what an operator must know into a text in the scene: mode, reason, distance.</summary>
    public sealed class StatusText : MonoBehaviour
    {
        public RigConnection Rig;
        public TextMesh Text;

        private void LateUpdate()
        {
            Twin twin = Rig.Twin;
            Text.text = twin == null ? Rig.Reason : Words(twin);
        }

        private static string Words(Twin twin)
        {
            string words = twin.Mode;
            if (twin.TimeToHandoverS.HasValue && twin.TimeToHandoverS.Value < 3.0)
            {
                words += "\nyour hand in " + twin.TimeToHandoverS.Value.ToString("0.0") + " s";
            }
            if (twin.DistanceUm.HasValue)
            {
                words += "\n" + (twin.DistanceUm.Value / 1000.0).ToString("0.00") + " mm to the critical area";
            }
            return twin.Reason.Length == 0 ? words : words + "\n" + twin.Reason;
        }
    }
}
