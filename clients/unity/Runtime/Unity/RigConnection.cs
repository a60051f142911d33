using System;
using System.Threading.Tasks;
using UnityEngine;

namespace MrNav.Unity
{
    /// <summary>Connects a scene to the server: sends the hand every frame, and gives the newest twin.</summary>
    public sealed class RigConnection : MonoBehaviour
    {
        [Tooltip("The computer on which `mrnav serve` runs.")]
        public string Host = "127.0.0.1";

        public int HandPort = 9000;
        public int WebPort = 8000;

        [Tooltip("The operator's token; the server prints it.")]
        public string Token = "";

        [Tooltip("Whose motion the robot follows; none only watches.")]
        public HandSource Hand;

        private HandLink _link;
        private HandPump _pump;
        private RigApi _api;

        /// <summary>What the operator should know: a lost connection, a refusal. On the main thread.</summary>
        public event Action<string> Noticed = delegate { };

        /// <summary>The newest twin; null while there is none.</summary>
        public Twin Twin
        {
            get { return _link == null ? null : _link.Twin; }
        }

        /// <summary>Why the hand does not control the rig; "" while it does.</summary>
        public string Reason
        {
            get { return _link == null ? "not connected" : _link.Reason; }
        }

        private void OnEnable()
        {
            _link = new HandLink(Host, HandPort, Token, SystemInfo.deviceName);
            _api = new RigApi("http://" + Host + ":" + WebPort, Token, () => _link.Session);
            _pump = new HandPump(_link);
            _link.Start();
        }

        private void OnDisable()
        {
            _pump.Dispose();
            _link.Dispose();
            _link = null;
        }

        private void Update()
        {
            if (Hand != null)
            {
                _pump.Give(Hand.Pose());
            }
            string notice;
            while (_link.TryTakeNotice(out notice))
            {
                Noticed(notice);
            }
        }

        /// <summary>Ask for a mode without waiting; a refusal is told by <see cref="Noticed"/>.</summary>
        public async void Ask(string ask)
        {
            await Told(() => _api.Ask(ask));
        }

        /// <summary>Stop the manipulator at once.</summary>
        public async void StopRig()
        {
            await Told(_api.Stop);
        }

        /// <summary>Mark a critical area where the robot is.</summary>
        public async void MarkHere(double epsilonUm)
        {
            Twin twin = Twin;
            if (twin == null || !twin.RobotVesselPx.HasValue)
            {
                Noticed("The robot is not seen: nothing to mark.");
                return;
            }
            await Told(() => _api.MarkArea(twin.RobotVesselPx.Value, epsilonUm));
        }

        private async Task Told(Action request)
        {
            try
            {
                await Task.Run(request);
            }
            catch (RefusedException refused)
            {
                Noticed(refused.Message);
            }
        }
    }
}
