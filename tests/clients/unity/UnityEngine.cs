// What the components use of Unity's classes, so that they are compiled without Unity. Nothing here does anything.
using System;

namespace UnityEngine
{
    public class Object
    {
        public string name;
    }

    public class Component : Object
    {
        public GameObject gameObject;
        public Transform transform;
    }

    public class Behaviour : Component
    {
    }

    public class MonoBehaviour : Behaviour
    {
    }

    public class Transform : Component
    {
        public Vector3 position;
        public Vector3 localPosition;
        public Vector3 localScale;

        public void SetParent(Transform parent, bool worldPositionStays)
        {
        }
    }

    public sealed class GameObject : Object
    {
        public Transform transform;
        public bool activeInHierarchy;

        public GameObject(string name)
        {
            this.name = name;
        }

        public void SetActive(bool value)
        {
        }

        public T AddComponent<T>()
            where T : Component
        {
            return null;
        }

        public static GameObject CreatePrimitive(PrimitiveType type)
        {
            return null;
        }
    }

    public enum PrimitiveType
    {
        Sphere,
    }

    public enum KeyCode
    {
        C,
        Space,
    }

    public static class Input
    {
        public static bool GetKey(KeyCode key)
        {
            return false;
        }

        public static bool GetKeyDown(KeyCode key)
        {
            return false;
        }
    }

    public static class Debug
    {
        public static void Log(object message)
        {
        }
    }

    public static class SystemInfo
    {
        public static string deviceName = "stand-in";
    }

    public sealed class TextMesh : Component
    {
        public string text;
        public float characterSize;
    }

    public sealed class TooltipAttribute : Attribute
    {
        public TooltipAttribute(string tooltip)
        {
        }
    }

    public struct Vector3
    {
        public float x;
        public float y;
        public float z;

        public Vector3(float x, float y, float z)
        {
            this.x = x;
            this.y = y;
            this.z = z;
        }

        public static Vector3 one
        {
            get { return new Vector3(1, 1, 1); }
        }

        public static Vector3 operator *(float scale, Vector3 a)
        {
            return new Vector3(scale * a.x, scale * a.y, scale * a.z);
        }
    }
}
