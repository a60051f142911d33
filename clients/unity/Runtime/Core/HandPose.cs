namespace MrNav
{
    /// <summary>The operator's fingertip as the headset sees it.</summary>
    public readonly struct HandPose
    {
        /// <summary>Where it is, in Unity's axes and metres: cumulative, the server forms the increments.</summary>
        public readonly Point3 PositionM;

        /// <summary>Whether the operator pinches: only then the robot follows.</summary>
        public readonly bool Clutch;

        /// <summary>Whether the hand is seen; false opens the clutch.</summary>
        public readonly bool Valid;

        public HandPose(Point3 positionM, bool clutch, bool valid)
        {
            PositionM = positionM;
            Clutch = clutch;
            Valid = valid;
        }
    }
}
