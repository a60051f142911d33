namespace MrNav
{
    /// <summary>
    /// The stage (µm; x right, y towards the operator, z up) and Unity's axes (metres; x right, y up, z away
    /// from the operator; left-handed). A model of the rig is shown larger than life by <c>scale</c>.
    /// </summary>
    public static class Frames
    {
        private const double MetresPerMicrometre = 1e-6;

        /// <summary>A point, or a difference of two, of the stage as Unity has it.</summary>
        public static Point3 UnityFromStage(Point3 stageUm, double scale = 1.0)
        {
            return MetresPerMicrometre * scale * new Point3(stageUm.X, stageUm.Z, -stageUm.Y);
        }

        /// <summary>A point, or a difference of two, of Unity on the stage.</summary>
        public static Point3 StageFromUnity(Point3 unityM, double scale = 1.0)
        {
            return 1.0 / (MetresPerMicrometre * scale) * new Point3(unityM.X, -unityM.Z, unityM.Y);
        }
    }
}
