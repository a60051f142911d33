using System.Collections.Generic;
using Newtonsoft.Json.Linq;

namespace MrNav
{
    /// <summary>What the server says about the rig at one moment. Lengths in µm on the stage.</summary>
    public sealed class Twin
    {
        /// <summary>Counts the published states.</summary>
        public readonly long Seq;

        /// <summary>The server's own clock, in seconds.</summary>
        public readonly double ServerTimeS;

        /// <summary>DISARMED, MANUAL, AUTO, HOLD, FAULT or STOP.</summary>
        public readonly string Mode;

        /// <summary>NONE, WARN, HOLD, FAULT or STOP.</summary>
        public readonly string Severity;

        /// <summary>Why, in plain words; show it.</summary>
        public readonly string Reason;

        /// <summary>Share of the motion that the hand commands, 0 to 1.</summary>
        public readonly double Authority;

        /// <summary>Whether the server takes the hand's motion.</summary>
        public readonly bool Clutch;

        /// <summary>Whether autonomy would be granted now; if not, <see cref="AutoRefusal"/> says why.</summary>
        public readonly bool AutoReady;

        public readonly string AutoRefusal;

        /// <summary>"searching", "acquiring" or "tracking".</summary>
        public readonly string Track;

        /// <summary>The magnet; null while it is not known.</summary>
        public readonly Point3? TipUm;

        /// <summary>The robot, on the floor of the vessel (z is 0); null while it is not seen.</summary>
        public readonly Point3? RobotUm;

        /// <summary>The robot in the vessel model's pixels (z is 0); null while it is not seen.</summary>
        public readonly Point3? RobotVesselPx;

        /// <summary>Id of the active critical area, or null.</summary>
        public readonly string CriticalArea;

        /// <summary>From the robot to the area's centre; null without either.</summary>
        public readonly double? DistanceUm;

        /// <summary>In AUTO, when the hand will have control; null otherwise.</summary>
        public readonly double? TimeToHandoverS;

        /// <summary>The planned path in the vessel model's pixels (z is 0).</summary>
        public readonly IReadOnlyList<Point3> PathVesselPx;

        /// <summary>Read a message of the type "twin" (docs/protocol.md has its fields).</summary>
        public Twin(JObject message)
        {
            Seq = message.Value<long>("seq");
            ServerTimeS = message.Value<double>("t");
            Mode = message.Value<string>("mode");
            Severity = message.Value<string>("severity");
            Reason = message.Value<string>("reason");
            Authority = message.Value<double>("authority");
            Clutch = message.Value<bool>("clutch");
            AutoReady = message.Value<bool>("auto_ready");
            AutoRefusal = message.Value<string>("auto_refusal");
            Track = message["track"].Value<string>("state");
            TipUm = Point(message["tip_um"]);
            RobotUm = Point(message["robot_um"]);
            RobotVesselPx = Point(message["robot_vessel_px"]);
            CriticalArea = message.Value<string>("critical_area");
            DistanceUm = message.Value<double?>("distance_um");
            TimeToHandoverS = message.Value<double?>("time_to_handover_s");
            var path = new List<Point3>();
            foreach (JToken point in message["path"])
            {
                path.Add(Point(point).Value);
            }
            PathVesselPx = path;
        }

        private static Point3? Point(JToken token)
        {
            var values = token as JArray;
            if (values == null)
            {
                return null;
            }
            double z = values.Count > 2 ? values[2].Value<double>() : 0.0;
            return new Point3(values[0].Value<double>(), values[1].Value<double>(), z);
        }
    }
}
