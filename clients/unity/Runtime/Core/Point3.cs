using System;

namespace MrNav
{
    /// <summary>Three coordinates; whoever names one says the frame and the unit.</summary>
    public readonly struct Point3 : IEquatable<Point3>
    {
        public readonly double X;
        public readonly double Y;
        public readonly double Z;

        public Point3(double x, double y, double z)
        {
            X = x;
            Y = y;
            Z = z;
        }

        public static Point3 operator +(Point3 a, Point3 b)
        {
            return new Point3(a.X + b.X, a.Y + b.Y, a.Z + b.Z);
        }

        public static Point3 operator -(Point3 a, Point3 b)
        {
            return new Point3(a.X - b.X, a.Y - b.Y, a.Z - b.Z);
        }

        public static Point3 operator *(double scale, Point3 a)
        {
            return new Point3(scale * a.X, scale * a.Y, scale * a.Z);
        }

        public double Length
        {
            get { return Math.Sqrt(X * X + Y * Y + Z * Z); }
        }

        /// <summary>Whether all three are finite: the server drops anything else.</summary>
        public bool IsFinite
        {
            get { return !double.IsNaN(X + Y + Z) && !double.IsInfinity(X + Y + Z); }
        }

        public bool Equals(Point3 other)
        {
            return X.Equals(other.X) && Y.Equals(other.Y) && Z.Equals(other.Z);
        }

        public override bool Equals(object other)
        {
            return other is Point3 && Equals((Point3)other);
        }

        public override int GetHashCode()
        {
            return (X.GetHashCode() * 397 ^ Y.GetHashCode()) * 397 ^ Z.GetHashCode();
        }
    }
}
