using MrNav.Unity;
using UnityEngine;

/// <summary>
/// Builds the sample scene: put it on an empty object where the table is, fill in the server's address and token,
/// and give it the transform that follows the operator's fingertip. The space key stops the rig.
/// </summary>
public sealed class TabletopRig : MonoBehaviour
{
    private const float RobotRadiusM = 0.0005f;
    private const float MagnetRadiusM = 0.0015f;

    public string Host = "127.0.0.1";
    public string Token = "";
    public Transform Fingertip;

    [Tooltip("How much larger than life the rig is shown.")]
    public float Scale = 20.0f;

    private RigConnection _rig;

    private void Awake()
    {
        // Inactive until it is filled in: it connects when it is enabled.
        var parts = new GameObject("mrnav");
        parts.SetActive(false);
        parts.transform.SetParent(transform, false);

        var hand = parts.AddComponent<TransformHand>();
        hand.Fingertip = Fingertip;
        _rig = parts.AddComponent<RigConnection>();
        _rig.Host = Host;
        _rig.Token = Token;
        _rig.Hand = hand;
        _rig.Noticed += notice => Debug.Log("mrnav: " + notice);

        var view = parts.AddComponent<TwinView>();
        view.Rig = _rig;
        view.Scale = Scale;
        view.Robot = Sphere("robot", RobotRadiusM, parts.transform);
        view.Magnet = Sphere("magnet", MagnetRadiusM, parts.transform);

        var status = new GameObject("status").AddComponent<StatusText>();
        status.transform.SetParent(parts.transform, false);
        status.transform.localPosition = new Vector3(0.0f, 0.3f, 0.2f);
        status.Rig = _rig;
        status.Text = status.gameObject.AddComponent<TextMesh>();
        status.Text.characterSize = 0.01f;

        parts.SetActive(true);
    }

    private void Update()
    {
        if (Input.GetKeyDown(KeyCode.Space))
        {
            _rig.StopRig();
        }
    }

    private Transform Sphere(string name, float radiusM, Transform parent)
    {
        GameObject sphere = GameObject.CreatePrimitive(PrimitiveType.Sphere);
        sphere.name = name;
        sphere.transform.SetParent(parent, false);
        sphere.transform.localScale = 2.0f * radiusM * Scale * Vector3.one;
        return sphere.transform;
    }
}
